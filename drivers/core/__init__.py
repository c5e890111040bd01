"""What drivers share: protocols, messages, links, numbering, clocks, errors."""
