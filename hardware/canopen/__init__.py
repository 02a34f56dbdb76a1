"""CANopen and its drive profile: objects, PDO, SDO, identification, configuration."""
