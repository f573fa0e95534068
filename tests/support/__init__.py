"""What tests share: sensors, parts that they stand on, files, machines to run on."""
