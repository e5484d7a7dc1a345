"""What all other packages stand on: arrays, errors, files, kernels, extensions, memory, names,
settings as tables.
"""
