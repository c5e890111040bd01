"""The finger torques of a BarrettHand on a CAN bus."""
