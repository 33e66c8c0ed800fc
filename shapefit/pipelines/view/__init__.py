"""`view`: results, shapes and landmarks as one page."""
