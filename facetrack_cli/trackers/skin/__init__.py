"""Face and hands by the colour of one person's skin: Gonzalez & Collet; Gianni, Collet & Dalle, GW 2007.

`likelihoods.py`: the skin's colour, learned from the face's box; a cloud, whose particles are pixels; how targets keep
off each other; skin and pattern together. `skin_kernels.py`: the loops. Recipes: `skin`, `ncc`, `skin_ncc`,
`head_hands` and variants.
"""
