"""Speed of jaxstage, measured against hand-written C++, numpy and scipy in the same minutes."""
