"""A slow, plain twin of trackers/face/landmark_kernels.py with its constants, in pixels. Imports nothing of ours.

S = 3 sensors: regression, detector, network. Places are (S, K, 2), what is said of each part (S, K).
"""

import math

import numpy as np

EYES = 40.656  # pixels between the eyes of the stabilized image


def ahead(reliability, error_rate):
    begins = min(0.1 * error_rate / (1 - error_rate), 0.9)
    return reliability * (1 - begins) + (1 - reliability) * 0.1


def readings(z, visible, bias, var, noise, reliability, error_rate, keep):
    known = np.isfinite(z).all(axis=2)
    at = np.where(known[..., None], z - keep * bias, 0)
    wide = keep**2 * var + (0.001 * EYES) ** 2 + noise + (0.1 * EYES) ** 2 * (1 - visible.min())
    sure = np.where(known, np.vectorize(ahead)(reliability, error_rate) * (0.1 + 0.9 * visible), 0)
    return at, wide, sure


def common(offsets):
    return np.median(offsets, axis=0) if len(offsets) > 2 else np.zeros(2)


def is_apart(one, other):
    (a, v, s), (b, w, t) = one, other
    return s > 0 and t > 0 and math.dist(a, b) ** 2 > 9 * (v + w)


def joined(one, other):
    """Two readings (place, variance, sureness) of a part in one."""
    (a, v, s), (b, w, t) = one, other
    if t == 0:
        return one
    first = 0 if is_apart(one, other) else s / v
    total = first + t / w
    return (first * np.asarray(a) + t / w * np.asarray(b)) / total, max(s, t) / total, max(s, t)


def fused(z, var, sure, before):
    of_part = [list(zip(z[:, k], var[:, k], sure[:, k], strict=True)) for k in range(len(before))]
    both = [joined(one[0], one[2]) for one in of_part]
    apart = any(is_apart(pair, one[1]) for pair, one in zip(both, of_part, strict=True))
    each = [joined(pair, one[1]) for pair, one in zip(both, of_part, strict=True)]
    used = [k for k, (_, _, s) in enumerate(each) if s > 0.5]
    shift = common(np.array([each[k][0] - before[k] for k in used]))
    if used:
        shift = shift * 1 / (1 + np.median([each[k][1] for k in used]) / (0.1 * EYES) ** 2)
    return np.array([at if s > 0 else (math.nan, math.nan) for at, _, s in both]), shift, apart


def compared(z, var, sure, at, cov, visible):
    own = np.array([one - common((one - at)[s > 0]) for one, s in zip(z, sure, strict=True)] + [at])
    var_of = np.vstack([var, np.trace(cov, axis1=1, axis2=2) / 2])
    sure_of = np.vstack([sure, 0.97 * visible])
    differ, cross = np.zeros(len(at), bool), np.zeros_like(sure)
    for k in range(len(at)):
        each = list(zip(own[:, k], var_of[:, k], sure_of[:, k], strict=True))
        differ[k] = any(is_apart(each[i], each[j]) for i in range(4) for j in range(i))
        one, other = ((z[s, k], var[s, k], sure[s, k]) for s in (0, 2))
        if min(one[2], other[2]) > 0 and not is_apart(one, other):
            cross[[0, 2], k] = math.dist(one[0], other[0]) ** 2 / 4
    return own, var_of, sure_of, differ, cross


def updated(z, state, cov, visible, log_odds, cross, least, keep, bias, var, noise, reliability, error_rate):
    out = []
    for s in range(len(z)):
        b, p = keep * bias[s], keep**2 * var[s] + (0.001 * EYES) ** 2
        right = np.array([ahead(*both) for both in zip(reliability[s], error_rate[s], strict=True)])
        r2, wrong = noise[s].copy(), error_rate[s].copy()
        off = z[s] - b - state
        seen = np.isfinite(off).all(axis=1)
        shift = common(off[seen])
        for k in range(len(state)) if seen.any() else ():
            total = p[k] + r2[k] + np.trace(cov[k]) / 2
            far, evidence = total + (0.25 * EYES) ** 2, log_odds[s, k]
            if math.isnan(evidence):
                squared = ((off[k] - shift) ** 2).sum() / 2
                evidence = math.log(far / total) - squared / total + squared / far if seen[k] else 0
            odds = right[k] / (1 - right[k]) * math.exp(visible[k] * min(max(evidence, -4), 4))
            right[k] = odds / (1 + odds)
            if seen[k]:
                squared = (off[k] ** 2).sum() / 2
                wrong[k] += 0.01 * visible[k] * (1 - right[k] - wrong[k])
                use = visible[k] * visible.min() * right[k] * (squared < 9 * total)
                b[k] += use * p[k] / total * off[k]
                p[k] *= 1 - use * p[k] / total
                r2[k] += 0.02 * use * (max(squared, cross[s, k]) - r2[k])
            wrong[k], r2[k] = np.clip(wrong[k], 0.01, 0.9), np.clip(r2[k], least[s] ** 2, (0.1 * EYES) ** 2)
        out.append((b, p, r2, right, wrong))
    return [np.array(values) for values in zip(*out, strict=True)]


def shown(at, cov, seen, below, ess, sides, carried, offset, var, bias_std, visible, head, known):
    """Rows (14, R) of a face, how they are seen: 0 visible, 1 hidden, 2 lost, and the corners of its box."""
    a, b, cx, cy, middle, scale, near, shown, least, patience, right, bottom, time, particles, *box = known
    matrix, nothing, rows, how = np.array([[a, -b], [b, a]]), (math.nan,) * 3, [], []
    own = [(v + o**2) * np.eye(2) for v, o in zip(var, bias_std, strict=True)]
    points = [*zip(at, cov, seen, seen, below >= patience, scale * sides, ess, strict=True)]
    others = zip(carried + offset, own, visible, np.ones(len(var)), strict=True)
    points += [(*other, False, nothing[:2], math.nan) for other in others]
    for j, (place, spread, visible_by, counts, doubted, size, count) in enumerate(points):
        spread = matrix @ spread @ matrix.T + (1 - visible_by * shown) * head
        right_by = shown * (1 - math.exp(-(near**2) / np.trace(spread)))
        places, std = matrix @ (place - middle) + (cx, cy), np.sqrt(np.diag(spread))
        rows.append([*places, math.nan, time, right_by * counts, *size, count, particles, *std, spread[0, 1]])
        hidden = (j >= len(at) and visible_by < least) or bool(((places < 0) | (places > (right, bottom))).any())
        how.append(2 if doubted or math.isnan(right_by) or right_by < least else int(hidden))
    sure, w, h, head_ess, angle, cos, sin, std_w, std_h, status = box
    of_box = [cx, cy, angle, time, sure, w, h, head_ess, particles, *np.sqrt(np.diag(head)), head[0, 1], std_w, std_h]
    rows = [[*row, *nothing[:2]] for row in rows]
    rows.insert(len(at), of_box)
    how.insert(len(at), int(status) or int(not (0 <= cx <= right and 0 <= cy <= bottom)))
    u, v = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]]) * [[(w - 1) / 2], [(h - 1) / 2]]
    corners = np.full((len(rows), 4, 2), np.nan)
    corners[len(at)] = np.stack([cx + cos * u - sin * v, cy + sin * u + cos * v], axis=1)
    return np.array(rows).T, how, corners
