"""A sensor in MuJoCo: its files, and its data as the results and messages of a real one."""
