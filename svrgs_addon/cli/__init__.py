"""The command line: its words, what each command does, progress, lists of scenes."""
