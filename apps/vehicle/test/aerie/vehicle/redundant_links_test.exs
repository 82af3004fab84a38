defmodule Aerie.Vehicle.RedundantLinksTest do
  @moduledoc "Redundant links to a vehicle: its answers to TIMESYNC are measured, and the better link carries."
  use Aerie.VehicleCase, async: true

  alias MavRouter.Router
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @loopback {127, 0, 0, 1}
  @key {"main", 1}

  # One autopilot with a radio for each of `ports`, which delays what goes through it by so many ms in each direction. It
  # answers TIMESYNC where it was asked, and tells the test what else it hears.
  defp autopilot(radios) do
    test = self()

    spawn_link(fn ->
      radios =
        for {port, delay} <- radios do
          {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: true])
          {socket, {port, delay}}
        end

      send(self(), :beat)
      fly(test, Map.new(radios), 0)
    end)
  end

  defp fly(test, radios, seq) do
    receive do
      :beat ->
        Process.send_after(self(), :beat, 100)

        for {_socket, {port, _delay}} = radio <- radios,
            do: say(radio, port, heartbeat(1, seq: rem(seq, 256)))

        fly(test, radios, seq + 1)

      {:udp, socket, _address, _port, bytes} ->
        {port, delay} = radios[socket]
        Process.send_after(self(), {:heard, socket, port, bytes}, delay)
        fly(test, radios, seq)

      {:heard, socket, port, bytes} ->
        {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, nil)
        for frame <- frames, do: answer(test, {socket, radios[socket]}, port, frame)
        fly(test, radios, seq)

      {:say, socket, port, bytes} ->
        :gen_udp.send(socket, @loopback, port, bytes)
        fly(test, radios, seq)
    end
  end

  defp say({socket, {_port, delay}}, port, bytes),
    do: Process.send_after(self(), {:say, socket, port, bytes}, delay)

  defp answer(test, radio, port, frame) do
    case MavCodec.decode(frame) do
      {:ok, %M.Timesync{tc1: 0, ts1: ts1}} ->
        now = System.os_time(:nanosecond)
        say(radio, port, MavCodec.encode(%M.Timesync{tc1: now, ts1: ts1}, system: 1, component: 1))

      {:ok, message} ->
        send(test, {:by, port, message})

      {:error, _unknown} ->
        :ok
    end
  end

  test "round trips of TIMESYNC by each link make its score, the better one carries, and the snapshot shows it" do
    config = %{
      mavlink: %{system_id: 245, component_id: 191, read_gcs_parameters: false, request_streams: false}
    }

    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    radio = fn id -> add_link(gateway, "udpin:127.0.0.1:0", id: id, options: [router: [group: "mast"]]) end
    # By name the slow one would come first.
    {"a-slow", slow} = radio.("a-slow")
    {"b-fast", fast} = radio.("b-fast")
    autopilot(%{slow => 200, fast => 0})

    quality = fn id -> (MavRouter.Link.get(gateway, id) || %{})[:quality] || %{} end
    eventually(fn -> quality.("a-slow")[:rtt_ms] && quality.("b-fast")[:rtt_ms] end)
    # However busy this machine is, the delays are in it.
    assert quality.("a-slow").rtt_ms >= 400
    assert %{group: "mast", loss: loss, age_ms: age} = quality.("a-slow")
    assert loss == 0.0 and is_integer(age)
    order = MavCodec.encode(%M.CommandLong{target_system: 1, command: 400}, system: 245, component: 191)

    # Our own words go by it, too. An answer that a busy machine delays turns the choice for a while.
    eventually(fn ->
      :ok = Router.send(gateway, @key, order)
      assert_receive {:by, by, %M.CommandLong{command: 400}}
      {a, b} = {quality.("a-slow"), quality.("b-fast")}
      by == fast and b.carries and not a.carries and b.score > a.score
    end)

    # What is configured for a class goes before, and one link may be asked for.
    for id <- ["a-slow", "b-fast"], do: :ok = Router.configure(gateway, id, carry: %{"control" => "a-slow"})
    :ok = Router.send(gateway, @key, order)
    assert_receive {:by, ^slow, %M.CommandLong{command: 400}}
    :ok = Router.send(gateway, @key, order, link: "b-fast")
    assert_receive {:by, ^fast, %M.CommandLong{command: 400}}
    for id <- ["a-slow", "b-fast"], do: :ok = Router.configure(gateway, id, carry: %{"control" => "all"})
    :ok = Router.send(gateway, @key, order)
    for port <- [slow, fast], do: assert_receive({:by, ^port, %M.CommandLong{command: 400}})
  end
end
