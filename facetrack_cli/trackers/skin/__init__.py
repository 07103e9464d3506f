"""Face and hands by the colour of one person's skin.

Gonzalez & Collet, "Face Tracking using a Combination of Colour and Pattern Matching based on Particle Filter", and
Gianni, Collet & Dalle, GW 2007, of a head and two hands.

- `likelihoods.py`: the skin's colour, learned from the face's box (section 3, eq. 4); a cloud, whose particles are
  pixels, and its box; how targets keep off each other; skin and pattern together (eq. 5 to 11).
- `settings.py`: what a recipe may say. `skin_kernels.py`: the loops.

Recipes: `skin`, `ncc`, `skin_ncc`, `head_hands` and variants.
"""
