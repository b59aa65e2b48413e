"""The device side of the link: commands in; acknowledgements and housekeeping out."""
