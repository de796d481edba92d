"""The command line: its parser, its commands, lists of scenes, and `svrgs render`."""
