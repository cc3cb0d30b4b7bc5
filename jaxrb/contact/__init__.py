"""Rigid contact: from shapes that come near each other to the impulses between them."""

from jaxrb.contact.surfaces import contact_of as contact_of
