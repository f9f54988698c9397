"""The machinery of ``warpdef view``: content, scene, window, pictures, movie and web page."""
