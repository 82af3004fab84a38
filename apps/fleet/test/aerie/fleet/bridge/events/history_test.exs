defmodule Aerie.Fleet.Bridge.Events.HistoryTest do
  @moduledoc "The events of the fleet in a span of time, from the stream and from the journal."
  use Aerie.BridgeCase, async: true

  alias Aerie.Fleet.Bridge.Events.History
  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir
  @moduletag :capture_log

  @at 1_795_213_361_000_000
  @second 1_000_000

  defp make(gateway, vehicle, seqs) do
    for seq <- seqs do
      event = Event.new(vehicle, "landed", seq, @at + seq * @second, nil, %{})
      Journal.commit(gateway, vehicle, :state, [event])
    end
  end

  defp seen(history), do: for(%{vehicle: vehicle, seq: seq} <- history.events, do: {vehicle, seq})

  for per_vehicle <- [false, true] do
    test "after a restart those of the run before are there (streams of vehicles: #{per_vehicle})", %{
      tmp_dir: dir
    } do
      config = config(dir, [{"nats.streams.events_per_vehicle", unquote(per_vehicle)}])
      gateway = start_bridge(config)
      await_up(gateway)
      make(gateway, "V-1", 1..3)
      make(gateway, "V-2", 2..2)
      await_empty(gateway)
      stop_bridge(gateway)

      other = start_bridge(config)
      conn = client(await_up(other))
      # What is not an event of a vehicle.
      Gnat.pub(conn, "fleet.test.V-1.event.landed", "{")
      Gnat.pub(conn, "fleet.test.V-1.event.landed", JSON.encode!(%{id: 7, vehicle: [], type: "landed"}))

      Gnat.pub(
        conn,
        "fleet.test.V-1.event.x",
        JSON.encode!(%{id: "x", vehicle: "V-1", type: "x", seq: 1, time: "now"})
      )

      {:ok, _pong} = Gnat.request(conn, "$JS.API.INFO", "")
      make(other, "V-1", 4..4)
      history = Bridge.past_events(other, @at, @at + 60 * @second)
      assert seen(history) == [{"V-1", 4}, {"V-1", 3}, {"V-2", 2}, {"V-1", 2}, {"V-1", 1}]
      assert history.problem == nil and history.cut == 0

      assert seen(Bridge.past_events(other, @at + 2 * @second, @at + 3 * @second)) |> Enum.sort() == [
               {"V-1", 2},
               {"V-1", 3},
               {"V-2", 2}
             ]
    end
  end

  test "without NATS, events of this run and the reason why older ones are missing" do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    start_supervised!({PubSub, gateway: gateway})
    make(gateway, "V-1", 1..2)

    assert %{problem: "there is no connection to NATS"} =
             history = Bridge.past_events(gateway, @at, @at + 60 * @second)

    assert seen(history) == [{"V-1", 2}, {"V-1", 1}]
    assert %{problem: nil} = History.read(gateway, :off, @at, @at + 60 * @second)
  end
end
