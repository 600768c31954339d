"""The worker and reader processes with their jobs, and the client that talks to them."""
