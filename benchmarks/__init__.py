"""Every figure that the README quotes, printed by a command, beside the peer that it is compared with."""
