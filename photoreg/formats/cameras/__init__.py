"""Files of cameras; `registry` knows them all."""
