"""What is fed to training and to judging."""
