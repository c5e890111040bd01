"""A six-axis force sensor that streams over UDP: ATI's Net F/T box and what speaks its RDT protocol."""
