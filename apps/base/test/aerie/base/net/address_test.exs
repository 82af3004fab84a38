defmodule Aerie.Base.Net.AddressTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.Address

  test "which addresses are this machine's own" do
    for ip <- [{127, 0, 0, 1}, {127, 9, 9, 9}, {0, 0, 0, 0, 0, 0, 0, 1}, {0, 0, 0, 0, 0, 0xFFFF, 0x7F00, 1}],
        do: assert(Address.loopback?(ip))

    for ip <- [
          {10, 0, 0, 1},
          {0, 0, 0, 0, 0, 0xFFFF, 0x0A00, 1},
          {0xFE80, 0, 0, 0, 0, 0, 0, 1},
          {0, 0, 0, 0, 0, 0, 0, 0}
        ],
        do: refute(Address.loopback?(ip))
  end

  test "HOST:PORT is read, and written as it is read" do
    assert Address.parse("127.0.0.1:14550", false) == {:ok, {127, 0, 0, 1}, 14_550}
    assert Address.parse("[::1]:14550", false) == {:ok, {0, 0, 0, 0, 0, 0, 0, 1}, 14_550}
    assert Address.parse("gcs.local:1", false) == {:ok, "gcs.local", 1}
    assert Address.parse(":0", true) == {:ok, {0, 0, 0, 0}, 0}

    for text <- ["127.0.0.1:14550", "[::1]:14550", "gcs.local:1"] do
      {:ok, host, port} = Address.parse(text, false)
      assert Address.format(host, port) == text
    end
  end

  test "a link-local address keeps its interface, which is looked for when it is needed" do
    assert Address.parse("[fe80::1%lo]:5", false) == {:ok, "fe80::1%lo", 5}
    assert Address.format("fe80::1%lo", 5) == "[fe80::1%lo]:5"
    {:ok, number} = :net.if_name2index(~c"lo")
    assert Address.scoped("fe80::1%lo") == {:ok, {0xFE80, number, 0, 0, 0, 0, 0, 1}}
    assert Address.scoped("fe80::1%7") == {:ok, {0xFE80, 7, 0, 0, 0, 0, 0, 1}}
    assert Address.scope({0xFE80, 7, 0, 0, 0, 0, 0, 1}) == {{0xFE80, 0, 0, 0, 0, 0, 0, 1}, 7}
    assert Address.format({0xFE80, number, 0, 0, 0, 0, 0, 1}, 5) == "[fe80::1%lo]:5"
    assert {:error, "there is no interface nosuch0" <> _} = Address.scoped("fe80::1%nosuch0")
    # Others have none.
    assert Address.with_scope({0xFD00, 0, 0, 0, 0, 0, 0, 1}, 7) == {0xFD00, 0, 0, 0, 0, 0, 0, 1}
    assert Address.scope({127, 0, 0, 1}) == {{127, 0, 0, 1}, 0}
  end

  test "what is wrong is named" do
    for {text, words} <- [
          {"", "host and port are missing"},
          {"host", "the port is missing"},
          {"host:", "the port is missing"},
          {"[::1]", "the port is missing"},
          {"::1:5", "an IPv6 address needs brackets: [::1]:PORT"},
          {":5760", "the host is missing"},
          {"host:0", "\"0\" is not a port (1 to 65535)"},
          {"host:70000", "\"70000\" is not a port (1 to 65535)"},
          {"[fe80]:1", "\"fe80\" is not an IPv6 address"},
          {"[fe80::1]:1", "a link-local address needs its interface: [fe80::1%eth0]:PORT"},
          {"[fe80::1%]:1", "\"\" is not an interface"},
          {"[fe80::1%a b]:1", "\"a b\" is not an interface"},
          {"[::1%lo]:1", "\"::1%lo\" is not an IPv6 address"},
          {"1.2.3:1", "\"1.2.3\" is neither an address nor a name"},
          {"300.1.1.1:1", "\"300.1.1.1\" is neither an address nor a name"},
          {"a b:1", "\"a b\" is neither an address nor a name"}
        ],
        do: assert(Address.parse(text, false) == {:error, words})
  end
end
