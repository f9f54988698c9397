"""A rig for a moving mesh: a few rigid bones, and at most four of them for every vertex.

Smooth skinning decomposition with rigid bones (Le and Deng 2012): the places of the mesh in all frames are explained by
linear blend skinning,

    x_ti  =  sum_b w_ib (R_tb y_i + s_tb),    w_ib >= 0,  sum_b w_ib = 1,  at most four w_ib above 0,

by alternating least squares over weights w (``weights``), bones R, s and the rest shape y (``bones``); ``decompose``
adds bones where the error is largest, and ``skeleton`` joins them to a tree.
"""
