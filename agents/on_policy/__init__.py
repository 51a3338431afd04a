"""What on-policy families share: epochs of whole episodes, advantages, critics."""
