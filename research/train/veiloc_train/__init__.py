"""Training of the networks of veiloc's attacks: inversion, positions, neighbours."""
