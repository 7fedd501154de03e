"""Goals from another program: messages, channel, checks, shaping."""
