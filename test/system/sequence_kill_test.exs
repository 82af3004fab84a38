defmodule Aerie.System.SequenceKillTest do
  @moduledoc "A gateway that is killed while five vehicles take off one after the other, and started again."

  use Aerie.RunCase, async: true

  import Aerie.SystemCase

  @moduletag :tmp_dir
  @ann "key-of-the-operator-ann"
  @ben "key-of-the-operator-ben"
  @fleet [{1, :ardupilot}, {2, :px4}, {3, :ardupilot}, {4, :px4}, {5, :ardupilot}]

  setup %{tmp_dir: folder} do
    [http, udp] = [free_tcp_port(), free_udp_port()]
    keys = private_file(folder, "keys", "ann #{@ann} role=operator\nben #{@ben} role=operator\n")

    config =
      config_file(folder,
        links: [%{id: "one", url: "udpin:127.0.0.1:#{udp}"}],
        http: %{port: http},
        nats: %{mode: :off},
        api: %{keys_file: keys},
        timeouts: patient()
      )

    sims =
      Map.new(@fleet, fn {n, firmware} ->
        options = [system: n, link: "udpout:127.0.0.1:#{udp}", home: {47.39 + n / 1000, 8.54, 488.0}]
        sim = start_supervised!({SimVehicle, fast_vehicle(firmware) ++ options}, id: n)
        SimVehicle.subscribe(sim)
        {n, sim}
      end)

    %{config: config, http: http, folder: folder, sims: sims}
  end

  defp id(n), do: "VID-00#{n}"
  defp ask(c, method, path, body \\ nil, key \\ @ann), do: rest(c.http, method, path, body, key: key)
  defp up(c), do: c |> ask(:get, "operations/up") |> elem(1)

  defp start(c) do
    run = open(["--config", c.config, "--quiet"])
    known = &match?({200, %{"groups" => %{"home" => _, "mode" => _}}}, ask(c, :get, "vehicles/#{id(&1)}"))
    eventually(fn -> get(c.http, "/sign-in") != nil end, "it answers", started_by())
    eventually(fn -> Enum.all?(1..5, known) end, "all five are known")
    run
  end

  # What is asked of readiness is tested elsewhere; here the vehicles are simulated ones.
  defp take_off({n, firmware}) do
    mode = if firmware == :px4, do: "AUTO_LOITER", else: "GUIDED"

    %{
      "vehicle" => id(n),
      "anyway" => true,
      "steps" => [
        %{"type" => "set_mode", "params" => %{"mode" => mode}},
        %{"type" => "arm"},
        %{"type" => "takeoff", "params" => %{"altitude" => 10 + n}},
        %{"wait" => "above", "m" => 5, "timeout_s" => 600}
      ]
    }
  end

  # The records of the audit log of both lives, each as `take` has it.
  defp audit(c, take) do
    for path <- c.folder |> Path.join("audit/*.jsonl") |> Path.wildcard() |> Enum.sort(),
        line <- File.stream!(path),
        found = take.(JSON.decode!(line)),
        do: found
  end

  defp decided(c),
    do:
      audit(
        c,
        &with(
          %{"type" => "decision", "vehicle" => id, "command" => type} <- &1,
          do: {id, type},
          else: (_ -> nil)
        )
      )

  test "it says who had begun, commands nobody, and goes on with the others only", c do
    run = start(c)
    body = %{"id" => "up", "sequence" => Enum.map(@fleet, &take_off/1), "timeout_s" => 120}
    assert {status, %{"state" => "running"}} = ask(c, :post, "operations", body)
    assert status in [200, 202]
    eventually(fn -> up(c)["counts"]["ok"] >= 2 end, fn -> "two are up: #{inspect(up(c))}" end)
    kill_9(c.config)
    await_exit(run)
    before = decided(c)

    start(c)
    assert %{"state" => "interrupted", "source" => "ann", "counts" => counts, "order" => order} = up(c)
    assert %{"ok" => 2} = counts
    waiting = Enum.take(order, -counts["waiting"])
    assert length(waiting) in 2..3
    # Nobody was commanded by the restart, and those that wait stand on the ground.
    assert decided(c) == before
    for id <- waiting, do: refute(SimVehicle.state(sim(c, id)).armed)
    # Some of them fly, so another take-off of all begins nobody either.
    assert {409, _in_the_air} = ask(c, :post, "operations", %{body | "id" => "other"})

    # The one that was under way may stand there armed: no other one is armed beside it.
    for id <- order -- waiting do
      eventually(fn -> settled?(c, id) end, "#{id} flies, or was disarmed")
    end

    continue = fn -> ask(c, :post, "operations/up/continue", %{}, @ben) end

    eventually(fn -> elem(continue.(), 0) in [200, 202] end, "it goes on")

    done = eventually(fn -> up(c)["state"] == "done" && up(c) end, fn -> "it is done: #{inspect(up(c))}" end)
    assert %{"source" => "ben"} = done
    for id <- waiting, do: assert(%{"state" => "ok"} = done["vehicles"][id])

    # Each was armed once at most, by the gateway's own record and by the vehicle's.
    for type <- ["arm", "takeoff"] do
      ids = for {id, ^type} <- decided(c), do: id
      assert ids == Enum.uniq(ids)
      assert waiting -- ids == []
    end

    for sim <- Map.values(c.sims), do: assert(armed(sim, 0) in 0..1)

    assert [{"begin", "ann"}, {"continue", "ben"}] ==
             audit(c, fn record ->
               with %{"type" => "operation", "id" => "up"} <- record,
                    do: {record["change"], record["source"]},
                    else: (_other -> nil)
             end)
  end

  defp sim(c, "VID-00" <> n), do: Map.fetch!(c.sims, String.to_integer(n))

  defp settled?(c, id) do
    state = SimVehicle.state(sim(c, id))
    stands_armed? = state.armed and not state.airborne
    if stands_armed?, do: ask(c, :post, "vehicles/#{id}/commands", %{"type" => "disarm"})
    not stands_armed?
  end

  defp armed(sim, n) do
    receive do
      {:sim, ^sim, :armed} -> armed(sim, n + 1)
    after
      0 -> n
    end
  end
end
