"""The paper's experiments, by the functions of `import shapefit`: `python -m
experiments`.
"""
