"""The torque policy: networks, checkpoints, export."""
