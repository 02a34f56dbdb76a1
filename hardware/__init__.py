"""The arm and the bus: protocols, commands, readings, and the virtual controller."""
