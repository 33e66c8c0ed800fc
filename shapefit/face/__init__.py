"""The functions of the package for Python: what the commands do, on arrays in place of files."""
