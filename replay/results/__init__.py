"""What a run leaves on disk: the files of a log, the tables of a run, and how they are read back (`load`)."""
