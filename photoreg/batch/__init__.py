"""Many objects, each refined, textured and reported on its own, on Dask."""
