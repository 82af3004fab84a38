# What went wrong with a download. Sourced by the scripts that download: apt-get, pip and npm tell it in words of their own, and a network that is
# away needs something else than a mirror that is old, a clock that is wrong or a disk that is full.

# One cause a line, the most certain first: what the program's output has (a regular expression, in any case), why, what to do. CLOCK is the machine's
# date.
download_causes() {
  cat <<'LIST'
no space left|enough free space|ENOSPC @ the disk is full @ make room on it, or take another folder, and run this again
not valid yet|not yet valid|not yet activated|CERT_NOT_YET_VALID @ the clock of this machine is slow: it says CLOCK @ set the clock (date -s, or timedatectl set-ntp true) and run this again
is expired \(invalid since|Release file .* expired @ the mirror's lists are too old, or the clock of this machine is fast: it says CLOCK @ set the clock if that is wrong; else the mirror is no longer updated: name another one in apt's sources
certificate.* expired|certificate has expired|CERT_HAS_EXPIRED @ the server's certificate has expired, or the clock of this machine is fast: it says CLOCK @ set the clock if that is wrong; else try another mirror or ask who runs it
hash sum mismatch|unexpected size|do not match the hashes|EINTEGRITY @ what came is not what its checksum says: the mirror is being updated, or a proxy changes what it passes on @ run this again in some minutes, or take another mirror
NOSPLIT|network require authentication @ something on the way answers in the server's place, such as the login page of a network @ log in to the network, and run this again
NO_PUBKEY|signatures couldn't be verified|signatures were invalid|EXPKEYSIG @ the mirror's lists are not signed by Debian's present keys @ apt-get install debian-archive-keyring, or name another mirror in apt's sources
CERTIFICATE_VERIFY_FAILED|certificate verif|UNABLE_TO_GET_ISSUER|SELF_SIGNED_CERT|certificate is not trusted @ the server's certificate is not one that this machine trusts (its clock says CLOCK) @ apt-get install ca-certificates, or have the certificate of your proxy installed
temporary failure resolving|could not resolve|name or service not known|name resolution|EAI_AGAIN|ENOTFOUND @ the name of the server is not found @ check the network and its name server (/etc/resolv.conf), and run this again
407 +Proxy|proxy authentication @ the proxy wants a login @ put it into http_proxy and https_proxy
404 +not found|HTTP error 404|E404|no matching distribution|unable to locate package|can't find a source to download @ the server does not have it @ if it is a mirror, it is incomplete or behind: take another one
50[0-9] +(internal|bad|service|gateway)|HTTP error 5[0-9][0-9]|E50[0-9] @ the server has a fault of its own @ run this again later, or take another mirror
403 +forbidden|401 +unauthorized|HTTP error 40[13]|E40[13] @ the server, or a proxy before it, refuses it @ check the address of the mirror and the proxy
connection refused|ECONNREFUSED @ the server refuses connections @ check the address of the mirror or proxy, and whether a firewall is in the way
timed? ?out|ETIMEDOUT|ERR_SOCKET_TIMEOUT|connection failed @ the server does not answer, or stopped in the middle @ run this again; if it stays so, take another mirror
network is unreachable|no route to host|ENETUNREACH|EHOSTUNREACH @ there is no way to the server @ check the network and run this again
connection reset|broken pipe|ECONNRESET|socket hang up @ the connection broke off @ run this again
is not signed|have a Release file @ what the server has is not Debian's @ name another mirror in apt's sources
LIST
}

# download_fault LOG: sets `why` and `cure` by what a program has written.
download_fault() {
  local pattern
  while IFS='@' read -r pattern why cure; do
    # What is around the separator.
    pattern=${pattern% } why=${why# } why=${why% } cure=${cure# }
    if grep -qiE -- "$pattern" "$1"; then
      why=${why/CLOCK/$(date '+%Y-%m-%d %H:%M %Z')}
      return
    fi
  done < <(download_causes)
  why="the lines above say it" cure="check the network and the disk, and run this again"
}
