"""What a refinement did, as pages of HTML that need no server."""
