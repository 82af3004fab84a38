defmodule Aerie.System.ManyTest do
  @moduledoc """
  Simulated vehicles of ArduPilot, PX4 and Betaflight behind a gateway: they take off one after the other, with a
  vehicle that cannot, with two operators, and with *Abort all* in the middle. Twelve, or as many as
  `MANY_VEHICLES` says, 60 at most: those want a machine with nothing else to do.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Audit
  alias Aerie.Fleet
  alias SimVehicle.Msp

  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag :long
  @moduletag timeout: 2_400_000
  @ann %{name: "ann", role: :operator, permissions: []}
  @ben %{name: "ben", role: :operator, permissions: []}
  @vehicles String.to_integer(System.get_env("MANY_VEHICLES", "12"))
  @msp 57..60
  @flyers 1..(@vehicles - 4)
  @links 4
  # Real vehicles climb and land no faster.
  @flight_ms 900_000
  # So many are up when everything is aborted.
  @up min(12, @vehicles - 6)

  setup %{tmp_dir: folder} do
    boards = for n <- @msp, do: {n, start_supervised!({Msp, firmware: :betaflight, uid: n})}
    msp = for {n, board} <- boards, do: "msp:tcp:127.0.0.1:#{Msp.port(board)}?sysid=#{n}"

    links = for(_n <- 1..@links, do: "udpin:127.0.0.1:0") ++ msp
    %{gateway: gateway} = start_gateway(folder, links: links, overrides: %{"timeouts" => patient()})

    sims =
      for n <- @flyers, into: %{} do
        firmware = if rem(n, 2) == 0, do: :px4, else: :ardupilot
        link = "udpout:127.0.0.1:#{link_port(gateway, "link-#{rem(n, @links) + 1}")}"
        # Fifty metres apart, and as slow as real ones, because there are many.
        home = {47.39 + div(n, 8) * 0.0005, 8.54 + rem(n, 8) * 0.0007, 488.0}
        options = Keyword.merge(fast_vehicle(firmware), speed: 1.0, system: n, link: link, home: home)
        sim = start_supervised!({SimVehicle, options}, id: n)
        SimVehicle.subscribe(sim)
        flown(fn -> on_ground?(gateway, n) end, "#{id(n)}, its home and landed state are known")
        {n, sim}
      end

    for n <- @msp,
        do: eventually(fn -> data(gateway, :health, {"main", n})[:ready_to_arm] end, "#{id(n)} is known")

    %{gateway: gateway, sims: sims, folder: folder}
  end

  defp on_ground?(gateway, n),
    do: data(gateway, :home, {"main", n})[:alt_msl] && data(gateway, :mode, {"main", n})[:in_air] == false

  defp id(n), do: "VID-0" <> String.pad_leading("#{n}", 2, "0")

  # One on a board comes sixth, which no operator may arm.
  defp order, do: Enum.to_list(1..5) ++ [57] ++ Enum.to_list(6..(@vehicles - 4))

  # Heights are stacked. What is asked of readiness is tested elsewhere; here the vehicles are simulated ones.
  defp take_off(c, more \\ %{}) do
    sequence =
      for n <- order() do
        %{"steps" => steps} = one = c.gateway |> Fleet.vehicle(id(n)) |> Fleet.take_off(10 + n, 1, true)
        # A busy machine flies slowly.
        %{
          one
          | "steps" => for(step <- steps, do: if(step["wait"], do: %{step | "timeout_s" => 600}, else: step))
        }
      end

    request = %{"id" => "up", "name" => "Take off", "sequence" => sequence, "timeout_s" => 120}
    Fleet.begin_operation(c.gateway, Map.merge(request, more), @ann, "elixir")
  end

  defp look(c, id \\ "up"), do: c.gateway |> Fleet.operation(id) |> elem(1)

  defp await(c, id \\ "up", words, holds),
    do: flown(fn -> holds.(look(c, id)) end, fn -> "#{words}: #{inspect(look(c, id))}" end)

  defp flown(holds, words), do: eventually(holds, words, System.monotonic_time(:millisecond) + @flight_ms)

  defp submit(c, n, type, who),
    do:
      Commands.submit(c.gateway, vehicle: id(n), type: type, as: who, deadline: System.os_time(:second) + 60)

  test "taken off one after the other, halted, continued, and returned in the middle", c do
    assert length(Fleet.vehicles(c.gateway)) == @vehicles
    readinesses = Fleet.readinesses(c.gateway, Fleet.vehicles(c.gateway), "ann")
    shown = Map.new(readinesses, fn {id, %{state: state}} -> {id, Atom.to_string(state)} end)
    assert map_size(shown) == @vehicles

    # One that somebody else has, and one that has changed since it was shown.
    {:ok, %{status: :completed}} = submit(c, 7, "take_control", @ben)
    assert {:error, {:conflict, why}} = take_off(c)
    assert why == "nothing was begun: #{id(7)} is in the charge of ben"
    {:ok, %{status: :completed}} = submit(c, 7, "release_control", @ben)
    wrong = if shown[id(8)] == "ready", do: "check", else: "ready"
    assert {:error, {:conflict, why}} = take_off(c, %{"shown" => %{id(8) => wrong}})
    assert why == "nothing was begun: #{id(8)} is #{shown[id(8)]} now, not #{wrong}"
    assert Fleet.airborne(c.gateway) == []

    # The sixth one fails, and on a busy machine one whose answers are lost; ben goes on without it.
    {:ok, _begun} = take_off(c)
    await(c, "#{@up} are up", &(&1["counts"]["ok"] >= @up or goes_on(c, &1)))
    assert {:ok, %{"id" => back, "order" => told}} = Fleet.abort_all(c.gateway, "rtl", @ann, "elixir")
    stopped = look(c)
    assert %{"state" => "stopped", "counts" => %{"under_way" => 0}} = stopped
    assert %{"result" => "denied"} = stopped["vehicles"][id(57)]
    up = for {id, %{"state" => "ok"}} <- stopped["vehicles"], do: id
    waiting = for {id, %{"state" => "waiting"}} <- stopped["vehicles"], do: id
    assert up -- told == []
    assert told -- waiting == told

    # All land at home. Nobody was armed twice, none beside one that stood armed on the ground, and no one that waited.
    all_land(c, back)
    for {_n, sim} <- Map.to_list(c.sims), do: SimVehicle.await(sim, &(not &1.armed), @flight_ms)
    flights = flights([], MapSet.new())
    assert flights == Enum.uniq(flights)
    assert for({n, sim} <- Map.to_list(c.sims), sim in flights, id(n) in waiting, do: n) == []
    acts = for %{"change" => change, "source" => who, "id" => "up"} <- records(c), do: {change, who}
    assert Enum.sort(Enum.uniq(acts)) == [{"abort", "ann"}, {"begin", "ann"}, {"continue", "ben"}]
  end

  defp goes_on(c, %{"state" => state}) do
    if state == "halted", do: Fleet.change_operation(c.gateway, "up", :continue, @ben, "elixir")
    false
  end

  # One whose command was lost, or that was not heard when all were told, is told again.
  defp all_land(c, back) do
    flown(fn -> flying(c) == [] or missed(c, back) != [] end, fn -> "they land: #{inspect(flying(c))}" end)

    if flying(c) != [] do
      {:ok, %{"id" => again}} = Fleet.abort_all(c.gateway, "rtl", @ann, "elixir")
      all_land(c, again)
    end
  end

  # The gateway may not hear one for a while on a busy machine.
  defp flying(c), do: for({n, sim} <- Map.to_list(c.sims), SimVehicle.state(sim).airborne, do: id(n))

  defp missed(c, back) do
    case look(c, back) do
      %{"done_at" => nil} ->
        []

      %{"vehicles" => told} ->
        for {id, _holder} <- Fleet.airborne(c.gateway), told[id]["state"] != "ok", do: id
    end
  end

  # Who armed, in order, with those that stand armed on the ground.
  defp flights(armed, standing) do
    receive do
      {:sim, sim, :armed} ->
        assert MapSet.size(standing) == 0
        flights([sim | armed], MapSet.put(standing, sim))

      {:sim, sim, now} when now in [:airborne, :disarmed] ->
        flights(armed, MapSet.delete(standing, sim))

      {:sim, _sim, _other} ->
        flights(armed, standing)
    after
      0 -> armed
    end
  end

  defp records(c) do
    {:ok, %{records: records}} = Audit.page(Path.join(c.folder, "audit"), %{type: "operation", limit: 50})
    records
  end
end
