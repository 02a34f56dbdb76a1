"""The virtual controller: nodes, plant and sensors of an arm that is not there."""
