"""An emulated Universal Robots controller: RTDE, script port and dashboard on a simulated arm."""
