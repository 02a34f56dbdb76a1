"""Panels that more than one step shows. Each turns a snapshot into lines and nothing else."""
