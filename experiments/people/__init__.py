"""How `make people` makes shapefit/data/people.h5: what only some bodies have is added,
and the file becomes small enough for the package.
"""
