"""YAML to checked settings: `load.py` reads a recipe, the others hold its sections. No numerics are imported here."""
