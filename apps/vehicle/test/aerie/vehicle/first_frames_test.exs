defmodule Aerie.Vehicle.FirstFramesTest do
  @moduledoc "The start of vehicles by the frames that the router delivers."
  use ExUnit.Case, async: true
  use Aerie.VehicleCase

  alias Aerie.Base.Names
  alias MavRouter.Tables

  @origin %{id: "a", network: "main", peer: :remote}

  defp deliver(gateway, bytes, origin \\ @origin) do
    {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), IO.iodata_to_binary(bytes), 5)
    Aerie.Reader.deliver(gateway, origin, frames)
  end

  # Of a vehicle that was not shown: is it waited for, is there a session, what has that heard, what does the starter do?
  defp known(gateway, key) do
    tables = Tables.of(gateway)
    session = Names.whereis(gateway, :session, key)

    %{
      waiting: {:ets.lookup(tables.waiting, key), :ets.info(tables.waiting, :size)},
      session: session && Map.take(:sys.get_state(session).core, [:component, :last_heard, :dirty, :shown]),
      shown: Aerie.Base.Store.vehicle(gateway, key),
      starter: gateway |> Names.whereis(:vehicle_starter) |> :sys.get_state()
    }
  end

  test "an autopilot's heartbeat starts its vehicle, and the read is its first (H2, H4)" do
    gateway = start_parts()
    assert %{unclaimed: 1} = deliver(gateway, attitude(1, 1))
    assert Names.whereis(gateway, :session, {"main", 1}) == nil
    assert %{delivered: 2, sessions: [session]} = deliver(gateway, [attitude(1, 1), heartbeat(1)])
    assert session == Names.whereis(gateway, :session, {"main", 1})
    # A second one changes nothing.
    assert %{delivered: 1, sessions: [^session]} = deliver(gateway, heartbeat(1))
  end

  test "of many that come at once a few are made at once, the others beside the frames' way; all get their first frames" do
    gateway = start_parts(%{limits: %{max_vehicles: 400}})
    deliver = &deliver(gateway, &1, %{@origin | network: &2})
    keys = many_vehicles(gateway, deliver)

    # One after the other, because all their starts may take a busy machine longer than a minute.
    for key <- keys do
      Aerie.Patience.eventually(
        fn -> match?(%{component: 1}, Aerie.Base.Store.vehicle(gateway, key)) end,
        fn -> "#{inspect(key)} is shown: #{inspect(known(gateway, key), limit: 30)}" end
      )
    end

    eventually(fn -> :ets.info(Tables.of(gateway).waiting, :size) == 0 end)

    assert Enum.map(frames(300), &number/1) == Enum.to_list(0..299)
  end
end
