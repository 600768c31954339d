"""Pictures of a registration: photos carried over, disagreement, lines."""
