"""The arm and the bus: commands, readings, and the virtual controller."""
