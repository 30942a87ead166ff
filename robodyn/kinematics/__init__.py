"""Where everything is: points along a motion, angles of links, transmission, ranges of joints."""
