"""What `tools/kill_commands.py` is made of: the commands, their deaths, and what they leave."""
