defmodule Aerie.Console.Access.AttemptsTest do
  @moduledoc "Wrong passwords lock whoever tries them, and nobody else."
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Access.Launch

  test "while somebody tries passwords from one address, the admin signs in from another, and by the printed address" do
    [console: console] = start_console(config: %{http: %{port: 0, proxies: ["127.0.0.1"]}})
    attacker = [{"x-forwarded-for", "198.51.100.66"}]
    admin = [{"x-forwarded-for", "203.0.113.7"}]

    for _try <- 1..5, do: assert(sign_in(console, "admin", "not-the-password", attacker).status == 403)
    locked = sign_in(console, "admin", password(:admin), attacker)
    assert locked.status == 429
    assert String.to_integer(locked.headers["retry-after"]) in 1..60
    # The address is not locked for another account, and the account not for another address.
    assert sign_in(console, "operator", password(:operator), attacker).status == 303
    assert sign_in(console, "admin", password(:admin), admin).status == 303
  end

  test "the printed address works whatever was tried on this machine" do
    [console: console] = start_console()
    for name <- ~w(admin operator viewer nobody), _try <- 1..6, do: sign_in(console, name, "not-the-password")
    assert sign_in(console, "admin", password(:admin)).status == 429
    for _guess <- 1..70, do: assert(get(console, "/launch?token=wrong").status == 403)

    path = console.gateway |> Launch.url(console.url) |> String.replace_prefix(console.url, "")
    assert get(console, path).status == 303
  end
end
