"""Reads and writes files, whole or not at all; a bad file gives one clear line.

In: paths, bytes, arrays. Out: images, meshes, tables, pictures for people.
Threads: none.
Other rooms use: `atomic_files`, `drawing`, `file_kinds`, `image_bytes`, `images`, `meshes`, `npz`,
    `tables`, `targets`.
"""
