"""The benchmark's data set: scenes declared by programs and poses, and the methods run on them."""
