"""Models of passage, segregation and displacement, one a file: what a physicist replaces."""
