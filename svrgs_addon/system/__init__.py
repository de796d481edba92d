"""The ground: what differs between operating systems, errors and exit status, packages, memory, kinds of
options. It imports no other room."""
