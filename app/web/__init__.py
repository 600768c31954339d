"""What knows viser's inside: access, uploads, bridge to the page's script, widgets."""
