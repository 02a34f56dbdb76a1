"""CAN buses: opening, sharing and recording them, and a loopback bus between processes."""
