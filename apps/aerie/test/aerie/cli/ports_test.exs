defmodule Aerie.CLI.PortsTest do
  @moduledoc "Default ports, looked for by several starts at once."
  use ExUnit.Case, async: true

  alias Aerie.CLI.Start.Ports

  @loopback {127, 0, 0, 1}

  for protocol <- [:tcp, :udp] do
    test "a port that was found for one #{protocol} listener is not found for another before it is opened" do
      find = &apply(Ports, :"free_#{unquote(protocol)}", [@loopback, &1])
      first = Enum.random(20_000..29_000)
      found = for _ <- 1..3, do: find.(first)
      assert [{:ok, a}, {:ok, b}, {:ok, c}] = found
      assert a >= first and a < b and b < c
    end
  end

  test "nor by another program" do
    port = Enum.random(20_000..29_000)
    name = {:local, "\0aerie-udp-#{port}"}
    {:ok, other} = :gen_udp.open(0, [:local, ip: name])
    assert {:ok, found} = Ports.free_udp(@loopback, port)
    assert found > port
    :gen_udp.close(other)
    assert {:ok, ^port} = Ports.free_udp(@loopback, port)
  end

  test "a port that somebody has open is not free" do
    {:ok, socket} = :gen_tcp.listen(0, ip: @loopback)
    {:ok, port} = :inet.port(socket)
    assert {:ok, found} = Ports.free_tcp(@loopback, port)
    assert found > port
  end
end
