"""What a pixel says: photos, colour spaces, exposure."""
