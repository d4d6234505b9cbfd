"""What runs in the virtual machine, with the Python of /opt/veilcam."""
