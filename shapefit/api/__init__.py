"""The functions of `import shapefit`: the pipelines of the commands, on arrays."""
