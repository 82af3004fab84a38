defmodule Aerie.Control.CommandExecutor.QuietLinkTest do
  @moduledoc "Commands over links whose vehicle is silent for minutes: a real link, router, session and executor."
  use ExUnit.Case, async: true

  import Aerie.GatewayCase
  import Aerie.LinkCase, only: [add_link: 3, snapshot: 2]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.CommandExecutor
  alias Aerie.Vehicle.Command
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @key {"main", 6}
  @summary %M.HighLatency2{
    type: 2,
    autopilot: 12,
    latitude: 473_977_420,
    longitude: 85_455_940,
    altitude: 500
  }

  setup do
    gateway = start_gateway(%{}, with: [:router, :links])
    {:ok, modem} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    %{gateway: gateway, modem: modem}
  end

  defp say(modem, port, message),
    do: :ok = :gen_udp.send(modem, {127, 0, 0, 1}, port, MavCodec.encode(message, system: 6, component: 1))

  # The next message that reaches the modem, and the gateway's port.
  defp heard(modem) do
    {:ok, {_address, port, bytes}} = :gen_udp.recv(modem, 0, Aerie.Patience.ms())
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, 0)
    {:ok, message} = MavCodec.decode(frame)
    {message, port}
  end

  # The vehicle says nothing for so long, as far as its link knows.
  defp silence(gateway, link, ms) do
    pid = Names.whereis(gateway, :link, link)

    :sys.replace_state(pid, fn %{core: core} = state ->
      peers = Map.new(core.peers.map, fn {id, peer} -> {id, %{peer | heard: peer.heard - ms}} end)
      core = %{core | peers: %{core.peers | map: peers}, heard: core.heard - ms, opened: core.opened - ms}
      %{state | core: core}
    end)

    send(pid, :tick)
    snapshot(gateway, link)
  end

  defp rtl(gateway) do
    {:ok, command} = Command.new(vehicle: "VID-006", type: "rtl")
    Task.async(fn -> CommandExecutor.submit(gateway, @key, command) end)
  end

  defp accepted(task, modem, port) do
    say(modem, port, %M.CommandAck{command: 20, result: 0, target_system: 237, target_component: 191})
    Task.await(task, Aerie.Patience.ms())
  end

  defp known(gateway),
    do: eventually(fn -> match?(%{high_latency: %{only?: true}}, Store.vehicle(gateway, @key)) end)

  for {what, high_latency?, silent_ms} <- [{"marked", true, 170_000}, {"found out", false, 70_000}] do
    test "X6: a sender that is silent for longer than a peer may be is still reached (a link that is #{what})",
         %{gateway: gateway, modem: modem} do
      {id, port} = add_link(gateway, "udpin:127.0.0.1:0", options: %{high_latency: unquote(high_latency?)})
      say(modem, port, @summary)
      known(gateway)
      assert %{peers: [_the_modem]} = silence(gateway, id, unquote(silent_ms))
      task = rtl(gateway)
      assert {%M.CommandLong{target_system: 6, command: 20}, ^port} = heard(modem)
      assert %{status: :accepted, details: %{"sent" => 1}} = accepted(task, modem, port)
    end
  end

  test "X6: a UDP client keeps its port, and says nothing by itself after its first words", context do
    %{gateway: gateway, modem: modem} = context
    {:ok, at} = :inet.port(modem)
    {id, _port} = add_link(gateway, "udpout:127.0.0.1:#{at}", options: %{high_latency: true})
    assert {%M.Heartbeat{}, port} = heard(modem)
    say(modem, port, @summary)
    known(gateway)
    # The once a second of links where nothing is heard would come by now.
    send(Names.whereis(gateway, :link_announcer), :announce)
    assert %{status: :idle, counters: %{reconnects: 0}} = silence(gateway, id, 7_200_000)
    send(Names.whereis(gateway, :link_announcer), :announce)
    _done = :sys.get_state(Names.whereis(gateway, :link_announcer))
    task = rtl(gateway)
    assert {%M.CommandLong{target_system: 6, command: 20}, ^port} = heard(modem)
    assert %{status: :accepted} = accepted(task, modem, port)
    assert :gen_udp.recv(modem, 0, 0) == {:error, :timeout}
  end
end
