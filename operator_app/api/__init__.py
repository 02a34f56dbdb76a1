"""The Python library: the folder `sarcal` is installed as `import sarcal`. No other package imports it."""
