"""What runs in the virtual machine, with the packages of the release."""
