"""What can be wrong with the look of a page, whatever it shows: no room, too small for a finger, too faint to read."""

WIDER = "[document.scrollingElement.scrollWidth, innerWidth, scrollX, scrollY]"
OUTSIDE = """[...document.querySelectorAll('button, input, canvas')].filter((one) => {
  const {left, right, width} = one.getBoundingClientRect();
  return one.checkVisibility() && width && (left < -0.5 || right > innerWidth + 0.5);
}).map((one) => one.dataset.testid ?? one.id)"""
TOO_SMALL = """[...document.querySelectorAll('button, input')].filter((one) => {
  // the label of a checkbox can be clicked, too
  const {width, height} = (one.type === 'checkbox' ? one.closest('label') : one).getBoundingClientRect();
  return one.checkVisibility() && (Math.round(width * 10) < 400 || Math.round(height * 10) < 400);
}).map((one) => `${one.dataset.testid ?? one.id}: ${one.offsetWidth}x${one.offsetHeight}`)"""
# what is written where, in which colour, on which ground; over the image the ground is the worse of black and white
FAINT = """() => {
  const probe = new OffscreenCanvas(1, 1).getContext("2d", {willReadFrequently: true});
  const rgba = (ink) => {
    probe.clearRect(0, 0, 1, 1);
    probe.fillStyle = ink;
    probe.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = probe.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = ([r, g, b, a], ground) => [r, g, b].map((one, i) => one * a + ground[i] * (1 - a));
  const light = (ink) => ink.map((one) => one / 255).map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4))
    .reduce((sum, one, i) => sum + one * [0.2126, 0.7152, 0.0722][i], 0);
  const grounds = (element) => {
    const layers = [];
    for (let one = element; one; one = one.parentElement) {
      const ground = rgba(getComputedStyle(one).backgroundColor);
      if (one.id === "view") break;
      layers.unshift(ground);
      if (ground[3] === 1) break;
    }
    return [[0, 0, 0], [255, 255, 255]].map((start) => layers.reduce((under, layer) => over(layer, under), start));
  };
  const written = (one) => one.matches("input:not([type=range])") || [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  const open = document.querySelector("dialog[open]");
  const found = [];
  let looked = 0;
  for (const one of (open ?? document.body).querySelectorAll("*")) {
    if (!written(one) || !one.checkVisibility({visibilityProperty: true}) || one.closest(".visually-hidden, noscript, :disabled")) continue;
    const ink = rgba(getComputedStyle(one).color);
    let opacity = 1;
    for (let up = one; up; up = up.parentElement) opacity *= Number(getComputedStyle(up).opacity);
    ink[3] *= opacity;
    const contrast = Math.min(...grounds(one).map((ground) => {
      const [a, b] = [light(over(ink, ground)), light(ground)];
      return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    }));
    looked += 1;
    if (contrast < 4.5) found.push(`${one.dataset.testid ?? one.id ?? one.className} “${one.textContent.trim().slice(0, 30)}”: ${contrast.toFixed(2)}`);
  }
  return [looked, found];
}"""  # noqa: E501


def wrong_looks(window, screen):
    """What is wrong, a tuple each, dark and light: text of less contrast than 4.5 to 1, what is outside of the window,
    what scrolls it; for fingers, what is smaller than 40 pixels."""
    found = []
    for scheme in ("light", "dark"):
        window.page.emulate_media(color_scheme=scheme)
        width, room, *scrolled = window.evaluate(WIDER)
        looked, faint = window.evaluate(FAINT)
        assert looked > 2
        small = window.evaluate(TOO_SMALL) if "has_touch" in screen else []
        wrong = [*(("faint", one) for one in faint), *(("small", one) for one in small)]
        wrong += [("outside", one) for one in window.evaluate(OUTSIDE)]
        if width > room or scrolled != [0, 0]:
            wrong.append(("scrolls", f"{width} in {room}, {scrolled}"))
        found += [(scheme, *one) for one in wrong]
    return found
