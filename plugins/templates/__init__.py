"""What `gelgate new` copies: of each kind of plugin one that works, and its test."""
