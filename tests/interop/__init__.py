"""Other people's programs as readers: `make test-interop` installs and asks them."""
