"""A hidden Markov model by plain enumeration: every path of states, its probability, and what it visits."""

import itertools
import math

import numpy as np


def paths(log_p, share, move):
    """The paths of states (T,) and their probabilities given all rows, by log likelihoods (T, S), logs of shares (S,)
    and of steps (T - 1, S, S).
    """
    frames, states = np.shape(log_p)
    found = {}
    for path in itertools.product(range(states), repeat=frames):
        log = share[path[0]] + sum(log_p[t][s] for t, s in enumerate(path))
        log += sum(move[t][a][b] for t, (a, b) in enumerate(itertools.pairwise(path)))
        found[path] = math.exp(log)
    total = sum(found.values())
    return {path: p / total for path, p in found.items()}


def posterior(found, t, state):
    """The probability of a state in row t."""
    return sum(p for path, p in found.items() if path[t] == state)


def visits(found, first, stop, states):
    """The probability that each of `states` is visited in rows `first` to before `stop`."""
    return sum(p for path, p in found.items() if set(states) <= {*path[first:stop]})
