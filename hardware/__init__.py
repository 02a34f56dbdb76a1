"""The arm and the bus: what commands and readings travel, and the virtual controller."""
