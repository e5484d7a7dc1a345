"""What asks the ego to drive slower, where its goal is, and who is passed while they go on."""
