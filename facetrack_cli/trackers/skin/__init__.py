"""Face and hands by the colour of one person's skin.

Gonzalez & Collet, "Face Tracking using a Combination of Colour and Pattern Matching based on Particle Filter", and
Gianni, Collet & Dalle, GW 2007, of a head and two hands.

- `settings.py`: what a recipe may say.
- `colour.py`: the skin's colour, learned from the face's box (section 3, eq. 4).
- `skin_ncc.py`: skin and pattern together (eq. 5 to 9); `ncc.py`: the pattern, eq. 10.
- `cloud.py`: each particle is a pixel; what the box of a cloud is; how targets keep off each other.

Loops are in `skin_kernels.py` and `ncc_kernels.py`. Recipes: `skin`, `ncc`, `skin_ncc`, `head_hands` and variants.
"""
