"""What Python programs import: the folder `sarcal` here is installed as `import sarcal`. Nothing here imports it."""
