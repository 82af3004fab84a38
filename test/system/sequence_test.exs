defmodule Aerie.System.SequenceTest do
  @moduledoc """
  A take-off of ArduPilot, PX4 and Betaflight together behind a whole gateway: one after the other, with one that
  cannot, and with another operator.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.{Commands, Missions}
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot
  alias Protocols.Mission.{Item, Plan}
  alias SimVehicle.Msp

  @moduletag :tmp_dir
  @moduletag :capture_log
  @ann %{name: "ann", role: :operator, permissions: []}
  @ben %{name: "ben", role: :operator, permissions: []}
  # Two of each firmware and one of MSP; a hundred metres apart.
  @fleet [{1, :ardupilot}, {2, :px4}, {3, :ardupilot}, {4, :px4}]
  @msp 7

  setup %{tmp_dir: folder} do
    msp = start_supervised!({Msp, firmware: :betaflight, uid: @msp})
    links = ["udpin:127.0.0.1:0", "msp:tcp:127.0.0.1:#{Msp.port(msp)}?sysid=#{@msp}"]

    shadow = %{"dir" => Path.join(folder, "shadow"), "hold_s" => 1}

    %{gateway: gateway} =
      start_gateway(folder, links: links, overrides: %{"timeouts" => patient(), "shadow" => shadow})

    port = link_port(gateway, "link-1")

    sims =
      Map.new(@fleet, fn {n, firmware} ->
        home = {47.39 + n / 1000, 8.54, 488.0}
        options = [link: "udpout:127.0.0.1:#{port}", system: n, home: home] ++ fast_vehicle(firmware)
        sim = start_supervised!({SimVehicle, options}, id: n)
        SimVehicle.await(sim, & &1.ready)
        {n, sim}
      end)

    for {n, _firmware} <- @fleet, do: await_standing(gateway, {"main", n})
    eventually(fn -> data(gateway, :health, {"main", @msp})[:ready_to_arm] end, "the one with MSP is known")
    %{gateway: gateway, sims: sims}
  end

  defp id(n), do: "VID-00#{n}"

  # What is asked of readiness is tested elsewhere; here the vehicles are simulated ones.
  defp take_off(c, ns) do
    sequence =
      for n <- ns do
        c.gateway |> Fleet.vehicle(id(n)) |> Fleet.take_off(10 + n, 3, true) |> patiently()
      end

    request = %{"id" => "up", "name" => "Take off", "sequence" => sequence, "timeout_s" => 120}
    Fleet.begin_operation(c.gateway, request, @ann, "elixir")
  end

  # A busy machine flies slowly.
  defp patiently(%{"steps" => steps} = vehicle),
    do: %{
      vehicle
      | "steps" => for(step <- steps, do: if(step["wait"], do: %{step | "timeout_s" => 600}, else: step))
    }

  defp look(c, id \\ "up"), do: c.gateway |> Fleet.operation(id) |> elem(1)
  defp await(c, id \\ "up", words, holds), do: eventually(fn -> holds.(look(c, id)) end, words)
  defp armed(c, n), do: SimVehicle.state(c.sims[n]).armed

  test "ArduPilot and PX4 go up one after the other; one that has MSP and no permission halts it, and the rest stays",
       c do
    {:ok, _begun} = take_off(c, [1, 2, @msp, 3, 4])
    halted = await(c, "it is halted", &(&1["state"] == "halted" && &1))
    assert %{"counts" => %{"ok" => 2, "failed" => 1, "waiting" => 2}} = halted
    assert %{"result" => "denied", "reason" => reason} = halted["vehicles"][id(@msp)]
    assert reason =~ "receiver"
    for n <- [1, 2], do: assert(SimVehicle.state(c.sims[n]).alt_rel > 2)
    for n <- [3, 4], do: refute(armed(c, n))

    # Another operator goes on without it, and aborts when the next one is up.
    {:ok, %{"source" => "ben"}} = Fleet.change_operation(c.gateway, "up", :continue, @ben, "elixir")
    await(c, "the third is up", &(&1["vehicles"][id(3)]["state"] == "ok"))
    {:ok, %{"then" => back}} = Fleet.change_operation(c.gateway, "up", {:abort, "land"}, @ben, "elixir")
    done = await(c, back, "all have been told", &(&1["state"] == "done" && &1))
    for n <- [1, 2, 3], do: assert(%{"state" => "ok"} = done["vehicles"][id(n)])
    for n <- [1, 2, 3, 4], do: SimVehicle.await(c.sims[n], &(not &1.armed))
    assert %{"state" => "stopped"} = look(c)
  end

  test "returned all, each is at a height of its own before it goes home", c do
    {:ok, _begun} = take_off(c, [1, 2, 3, 4])
    await(c, "all are up", &(&1["state"] == "done"))

    # As high as it was when it began to go home.
    heights =
      for {_n, sim} <- c.sims do
        Task.async(fn ->
          SimVehicle.await(sim, &(String.contains?(to_string(&1.mode), "RTL") && &1.alt_rel), :infinity)
        end)
      end

    {:ok, %{"id" => back}} = Fleet.abort_all(c.gateway, "rtl", @ann, "elixir")
    assert [lowest | _higher] = heights = heights |> Task.await_many(:infinity) |> Enum.sort()
    assert_in_delta lowest, 30, 1.5
    for [one, other] <- Enum.chunk_every(heights, 2, 1, :discard), do: assert(other - one > 1)
    done = await(c, back, "all have been told", &(&1["state"] == "done" && &1))
    for n <- 1..4, do: assert(%{"state" => "ok"} = done["vehicles"][id(n)])
  end

  test "each gets its own mission by one operation; Betaflight, which has none, is refused with the reason",
       c do
    point = fn n, east ->
      %Item{command: 16, frame: 3, x: 473_900_000 + n * 10_000, y: 85_400_000 + east, z: 20.0 + n}
    end

    hashes =
      for n <- [1, 2, 3, 4, @msp], into: %{} do
        {:ok, text} = Missions.export(%Plan{items: for(east <- 1..n, do: point.(n, east * 5_000))}, :plan)
        {:ok, hash} = Fleet.Shadow.put_plan(c.gateway, text, @ann)
        {n, hash}
      end

    sequence =
      for {n, hash} <- hashes,
          do: %{
            "vehicle" => id(n),
            "steps" => [%{"shadow" => %{"desired" => %{"mission" => %{"plan" => hash}}}}]
          }

    {:ok, %{status: :completed}} = Commands.submit(c.gateway, vehicle: id(1), type: "take_control", as: @ben)

    request = %{
      "id" => "send",
      "name" => "Send missions",
      "await" => "converged",
      "step" => 20,
      "halt_ratio" => 1
    }

    {:ok, _begun} = Fleet.begin_operation(c.gateway, Map.put(request, "sequence", sequence), @ann, "elixir")
    # One in somebody's charge waits until it is not, and the others do not wait for it.
    await(c, "send", "the first is held", &(&1["vehicles"][id(1)]["step"] == "shadow_held"))
    await(c, "send", "the others are aboard", &(&1["counts"]["ok"] == 3))

    {:ok, %{status: :completed}} =
      Commands.submit(c.gateway, vehicle: id(1), type: "release_control", as: @ben)

    done = await(c, "send", "it is done", &(&1["state"] == "done" && &1))
    for n <- 1..4, do: assert(%{"state" => "ok", "result" => "converged"} = done["vehicles"][id(n)])
    assert %{"result" => "refused", "reason" => reason} = done["vehicles"][id(@msp)]
    assert reason =~ "Betaflight has no missions"

    for n <- 1..4 do
      assert {:ok, %{plan: %{items: items}}} = Missions.download(c.gateway, id(n), :mission)
      assert length(items) == n
    end
  end

  # Some 60 metres north of its home.
  defp land_at(c, n, id) do
    place = %{"lat" => 47.39 + n / 1000 + 60 / 111_195, "lon" => 8.54, "altitude" => 8}
    {:ok, steps} = c.gateway |> Fleet.vehicle(id(n)) |> Fleet.land_at(place)
    request = %{"id" => id, "name" => "Land here", "sequence" => [patiently(steps)], "timeout_s" => 120}
    {:ok, _begun} = Fleet.begin_operation(c.gateway, request, @ann, "elixir")
    place
  end

  defp metres_from(c, n, %{"lat" => lat, "lon" => lon}),
    do: c.gateway |> Fleet.vehicle(id(n)) |> Snapshot.distance({lat, lon})

  test "ArduPilot and PX4 land at a place; one that is held on the way, or returns by its failsafe, does not",
       c do
    {:ok, _begun} = take_off(c, [1, 2, 3, 4])
    await(c, "all are up", &(&1["state"] == "done"))
    places = Map.new(1..4, &{&1, land_at(c, &1, "land-#{&1}")})

    for n <- 1..4,
        do: await(c, "land-#{n}", "it is on its way", &(&1["vehicles"][id(n)]["step"] == "wait_near"))

    {:ok, %{status: :completed}} = Commands.submit(c.gateway, vehicle: id(3), type: "hold", as: @ben)
    SimVehicle.failsafe(c.sims[4], :battery_critical)

    for n <- 1..2 do
      await(c, "land-#{n}", "it has been told", &(&1["state"] == "done" and &1["counts"]["ok"] == 1))
      SimVehicle.await(c.sims[n], &(not &1.armed))
      assert metres_from(c, n, places[n]) < 4
    end

    for {n, why} <- [{3, "given hold by ben"}, {4, "its mode was changed to AUTO_RTL"}] do
      failed = await(c, "land-#{n}", "it is given up", &(&1["counts"]["failed"] == 1 and &1))
      assert failed["vehicles"][id(n)]["reason"] =~ why
      assert metres_from(c, n, places[n]) > 10
    end

    # The other one may have come home.
    assert SimVehicle.state(c.sims[3]).alt_rel > 5
  end
end
