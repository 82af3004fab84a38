defmodule Aerie.System.OperationsTest do
  @moduledoc """
  Three simulated vehicles behind a whole gateway, commanded and changed together over REST and NATS; the examples of docs/fleet.md and
  docs/shadow.md.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Params
  alias Aerie.Fleet.Bridge

  @moduletag :tmp_dir
  @moduletag :capture_log
  @chief "key-of-the-chief-0001"
  @wall "key-of-the-wall-00001"
  @ids ["VID-001", "VID-002", "VID-003"]
  @docs Path.expand("../../docs", __DIR__)
  @fleet File.read!(Path.join(@docs, "fleet.md"))
  @shadow File.read!(Path.join(@docs, "shadow.md"))

  setup %{tmp_dir: folder} do
    keys = private_file(folder, "keys", "chief #{@chief} role=admin\nwall #{@wall} role=viewer\n")

    overrides = %{
      "policy" => %{"unsigned" => "admin"},
      "api" => %{"keys_file" => keys},
      "timeouts" => patient(),
      "shadow" => %{"dir" => Path.join(folder, "shadow"), "hold_s" => 1, "lease_s" => 2}
    }

    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    sims =
      for n <- 1..3 do
        options = [link: link, system: n] ++ fast_vehicle(:ardupilot)
        sim = start_supervised!({SimVehicle, options}, id: n)
        SimVehicle.await(sim, & &1.ready)
        sim
      end

    for n <- 1..3, do: await_standing(gateway, {"main", n})
    %{gateway: gateway, sims: sims, conn: nats_client(gateway)}
  end

  defp ask(c, method, path, body \\ nil, key \\ @chief) do
    case rest(c.gateway, method, path, body, key: key) do
      # A machine that stands still for seconds.
      {503, %{"error" => %{"code" => "unavailable"}}} -> ask(c, method, path, body, key)
      answer -> answer
    end
  end

  defp nats(c, action, body),
    do: nats_request(c.conn, "fleet.test.#{Bridge.name(c.gateway)}.operation.#{action}", body)

  defp over(look) do
    eventually(
      fn ->
        operation = look.()
        if operation["state"] != "running", do: operation
      end,
      fn -> "it is over; it is #{inspect(look.())}" end
    )
  end

  # The gateway never sends these twice by itself. When a datagram was lost on a busy machine, the operator gives the command again.
  defp command!(c, id, type, params) do
    eventually(
      fn ->
        case result(c, "vehicles/#{id}/commands", %{"type" => type, "params" => params}) do
          %{"result" => result} when result in ["accepted", "completed"] -> true
          %{"result" => result, "acknowledged" => false} when result in ["timeout", "unknown"] -> false
          # The vehicle took it; that it does it is waited for afterwards.
          %{"result" => result, "acknowledged" => true} when result in ["timeout", "unknown"] -> true
          %{"result" => "expired", "sent" => 0} -> false
          # The one before was taken, and its answer lost.
          %{"result" => result} when result in ["rejected", "denied"] and type == "takeoff" -> flies?(c, id)
        end
      end,
      "#{id} takes #{type}"
    )
  end

  defp flies?(c, "VID-" <> system),
    do: SimVehicle.state(Enum.at(c.sims, String.to_integer(system) - 1)).alt_rel > 1

  # A busy machine may take longer than the answer to the request waits.
  defp result(c, path, command) do
    case ask(c, :post, path, command) do
      {202, %{"id" => id}} ->
        look = fn -> c |> ask(:get, "#{path}/#{id}") |> elem(1) end

        eventually(
          fn ->
            now = look.()
            if now["state"] == "done", do: now
          end,
          "it has a result"
        )

      {_status, result} ->
        result
    end
  end

  defp altitude(gateway, id) do
    {:ok, %{value: value}} = Params.get(gateway, id, "FENCE_ALT_MAX")
    value
  end

  # The vehicles of the page, by the names that they have here.
  defp here(text), do: String.replace(text, ["sim-001", "sim-002"], &String.replace(&1, "sim", "VID"))

  test "a roll-out over REST halts at the first vehicle that refuses; over NATS another one reaches all", c do
    change = fn params -> %{"desired" => %{"params" => params}, "reason" => "festival"} end

    begin = %{
      "id" => "odd",
      "vehicles" => @ids,
      "step" => 1,
      "halt_ratio" => 0,
      "await" => "converged",
      "timeout_s" => 20,
      # More than the vehicle takes.
      "shadow" => change.(%{"NO_SUCH_PARAM" => 1})
    }

    assert {403, _refused} = ask(c, :post, "operations", begin, @wall)
    assert {status, %{"id" => "odd", "state" => "running"}} = ask(c, :post, "operations", begin)
    assert status in [200, 202]
    halted = over(fn -> c |> ask(:get, "operations/odd") |> elem(1) end)
    assert %{"state" => "halted", "counts" => %{"failed" => 1, "waiting" => 2, "ok" => 0}} = halted
    assert %{"VID-001" => %{"state" => "failed", "reason" => reason}} = halted["vehicles"]
    assert is_binary(reason)
    assert {:ok, %{"desired" => untouched}} = Aerie.Fleet.Shadow.get(c.gateway, "VID-002")
    assert untouched == %{}

    # The same operation again begins nothing; what was wished is taken back.
    assert {_status, %{"state" => "halted"}} = ask(c, :post, "operations", begin)
    assert {200, _done} = ask(c, :patch, "vehicles/VID-001/shadow", %{"desired" => %{"params" => nil}})

    begin = %{begin | "id" => "even", "timeout_s" => 300, "shadow" => change.(%{"FENCE_ALT_MAX" => 70})}
    assert %{"result" => "ok", "state" => "running"} = nats(c, "begin", begin)
    done = over(fn -> nats(c, "get", %{"id" => "even"}) end)
    assert %{"state" => "done", "counts" => %{"ok" => 3, "failed" => 0}} = done
    for id <- @ids, do: assert(altitude(c.gateway, id) == 70.0)
    assert %{"operations" => [_, _]} = nats(c, "list", %{})
    assert %{"result" => "refused", "rule" => "unknown"} = nats(c, "get", %{"id" => "none"})
  end

  defp take_off(c) do
    for id <- @ids do
      for {type, params} <- [
            {"set_mode", %{"mode" => "GUIDED"}},
            {"arm", %{}},
            {"takeoff", %{"altitude" => 10}}
          ] do
        command!(c, id, type, params)
      end
    end

    for sim <- c.sims, do: SimVehicle.await(sim, &(&1.alt_rel > 8))
  end

  test "one that is given hold while it waits for its turn to return holds, and the other returns", c do
    take_off(c)
    turn = %{"wait" => "landed", "of" => "VID-001", "timeout_s" => 600}
    home = %{"type" => "rtl"}

    begin = %{
      "id" => "turns",
      "step" => 2,
      "halt_ratio" => 1,
      "timeout_s" => 120,
      "sequence" => [
        %{"vehicle" => "VID-002", "steps" => [turn, home]},
        %{"vehicle" => "VID-003", "steps" => [turn, home]}
      ]
    }

    assert {_status, %{"state" => "running"}} = ask(c, :post, "operations", begin)
    command!(c, "VID-002", "hold", %{})
    [_first, held, last] = c.sims
    SimVehicle.await(held, &(&1.mode not in ["GUIDED", "RTL", "LAND"]))
    %{mode: mode} = SimVehicle.state(held)
    command!(c, "VID-001", "rtl", %{})
    done = over(fn -> c |> ask(:get, "operations/turns") |> elem(1) end)
    assert %{"state" => "done", "counts" => %{"ok" => 1, "failed" => 1}} = done
    assert %{"result" => "rejected", "reason" => why} = done["vehicles"]["VID-002"]
    assert why =~ "it was given hold by chief at "
    SimVehicle.await(last, &(&1.mode in ["RTL", "LAND"]))
    assert %{mode: ^mode} = SimVehicle.state(held)
  end

  test "a command for several in the air, stopped between two of them", c do
    take_off(c)

    begin = %{
      "id" => "home",
      "vehicles" => @ids,
      "step" => 1,
      "pause_s" => 600,
      "timeout_s" => 120,
      "command" => %{"type" => "rtl"}
    }

    assert {_status, %{"state" => "running"}} = ask(c, :post, "operations", begin)
    SimVehicle.await(hd(c.sims), &(&1.mode in ["RTL", "LAND"]))
    look = fn -> c |> ask(:get, "operations/home") |> elem(1) end
    eventually(fn -> look.()["counts"]["ok"] == 1 end, "the first one has succeeded")
    assert {403, _refused} = ask(c, :delete, "operations/home", nil, @wall)
    assert {200, _stopped} = ask(c, :delete, "operations/home")
    assert %{"state" => "stopped", "counts" => %{"waiting" => 2}} = over(look)
    for sim <- tl(c.sims), do: assert(%{mode: "GUIDED"} = SimVehicle.state(sim))
  end

  test "the examples of docs/fleet.md do what it says", c do
    [_all, body] = Regex.run(~r/-d '(\{"id": "home-1".+?\})' \\/s, @fleet)
    assert {_status, %{"id" => "home-1"}} = ask(c, :post, "operations", here(body))

    [look, stop] =
      for [_all, path] <- Regex.scan(~r{127\.0\.0\.1:4000/api/(operations/\S+)}, @fleet), do: path

    home = over(fn -> c |> ask(:get, look) |> elem(1) end)
    assert Map.keys(home["vehicles"]) == ["VID-001", "VID-002"]
    assert {200, _stopped} = ask(c, :delete, stop)

    for id <- @ids,
        do:
          assert(
            {200, _done} = ask(c, :patch, "vehicles/#{id}/shadow", %{"desired" => %{"tags" => ["survey"]}})
          )

    # As it is written it gives each vehicle a minute, which a busy machine may need more than.
    [_all, recipe] = Regex.run(~r/```json\n(.+?)```/s, @fleet)
    %{"id" => id} = recipe = JSON.decode!(recipe)
    recipe = Map.put(recipe, "timeout_s", 300)
    assert {_status, %{"id" => ^id, "state" => "running"}} = ask(c, :post, "operations", recipe)

    assert %{"state" => "done", "counts" => %{"ok" => 3}} =
             over(fn -> c |> ask(:get, "operations/#{id}") |> elem(1) end)

    for id <- @ids, do: assert(altitude(c.gateway, id) == 80.0)

    [_all, all] = Regex.run(~r/at once: `(\{.+?\})`\./, @fleet)
    assert {_status, %{"id" => id, "vehicles" => vehicles}} = ask(c, :post, "operations", all)
    assert map_size(vehicles) == 3
    over(fn -> c |> ask(:get, "operations/#{id}") |> elem(1) end)
  end

  test "the examples of docs/shadow.md do what it says", c do
    [_all, body, path] = Regex.run(~r{-d '(.+?)' \\\n +http://127\.0\.0\.1:4000/api/(\S+)}s, @shadow)
    # One that was told to try again may have been taken all the same.
    assert {200, %{"version" => version}} = ask(c, :patch, here(path), body)
    assert version in 1..9
    [_all, path] = Regex.run(~r{127\.0\.0\.1:4000/api/(vehicles/\S+/delta)}, @shadow)
    assert {200, %{"fields" => _fields}} = ask(c, :get, here(path))

    eventually(
      fn ->
        {200, %{"reported" => %{"fields" => fields}}} = ask(c, :get, "vehicles/VID-001/shadow")
        for {_path, %{"state" => state}} <- fields, uniq: true, do: state
      end
      |> then(fn states -> fn -> states.() == ["converged"] end end),
      "it is as desired"
    )

    assert altitude(c.gateway, "VID-001") == 80.0

    # What the text says in passing.
    for [object] <- Regex.scan(~r/(?<=`)\{"desired": .+?\}(?=`)/, @shadow),
        do: assert({200, _done} = ask(c, :patch, "vehicles/VID-002/shadow", object))

    plan = Protocols.Mission.File.QgcPlan.write(%Protocols.Mission.Plan{})
    hash = :crypto.hash(:sha256, plan) |> Base.encode16(case: :lower)
    assert @shadow =~ "http://127.0.0.1:4000/api/plans"
    assert {_status, %{"plan" => ^hash}} = ask(c, :post, "plans", plan)
    [_all, both] = Regex.run(~r/Then set `(\{.+?\})`;/, @shadow)
    desired = String.replace(both, "HASH", hash)
    assert {200, _done} = ask(c, :patch, "vehicles/VID-003/shadow", ~s({"desired": #{desired}}))

    for operation <- ["get", "delta"] do
      assert %{"result" => "ok"} = nats_request(c.conn, "fleet.test.VID-001.shadow.#{operation}", "")
    end

    {200, metrics} = rest(c.gateway, :get, "/metrics", nil, key: @chief)
    for [name] <- Regex.scan(~r/gateway_shadow_\w+/, @shadow), do: assert(metrics =~ name)
  end

  test "strangers and viewers begin nothing; what is too much, doubled or odd is refused", c do
    goto = %{
      "type" => "goto",
      "params" => %{"lat" => 47.39771234567891, "lon" => 8.545600000001, "altitude" => 19.999999}
    }

    near = %{"wait" => "near", "lat" => 47.3977123, "lon" => 8.5456, "m" => 3}
    landing = &%{"vehicle" => &1, "steps" => [goto, near, %{"type" => "land"}]}
    back = &%{"vehicle" => &1, "steps" => [%{"type" => "rtl"}]}

    begins = [
      %{"sequence" => [landing.("VID-001")]},
      %{"sequence" => [back.("VID-001"), back.("VID-002")]},
      %{"vehicles" => @ids, "command" => %{"type" => "set_mode", "params" => %{"mode" => "LAND"}}},
      %{"vehicles" => @ids, "command" => %{"type" => "mission_start"}}
    ]

    paths = ["operations/odd/pause", "operations/odd/continue", "operations/odd/abort", "abort"]

    for {key, status} <- [{nil, 401}, {"key-of-a-stranger-01", 401}, {@wall, 403}] do
      for begin <- begins, do: assert({^status, _refused} = ask(c, :post, "operations", begin, key))
      for path <- paths, do: assert({^status, _refused} = ask(c, :post, path, %{}, key))
    end

    for {begin, refused, why} <- [
          {%{"vehicles" => for(n <- 1..2_001, do: "V-#{n}"), "command" => %{"type" => "rtl"}}, 422,
           "2000 ids"},
          {%{"sequence" => for(n <- 1..2_001, do: back.("V-#{n}"))}, 422, "2000 vehicles"},
          {%{"sequence" => [back.("VID-001"), back.("VID-001")]}, 409, "VID-001 is in the sequence twice"},
          {%{
             "sequence" => [
               landing.("VID-001"),
               put_in(landing.("VID-002"), ["steps", Access.at(1), "lat"], 48)
             ]
           }, 422, "steps[1].m"},
          {%{"vehicles" => @ids, "command" => put_in(goto, ["params", "lat"], 1.0e308)}, 422, "lat"},
          {%{"vehicles" => @ids, "command" => put_in(goto, ["params", "altitude"], nil)}, 422, "altitude"}
        ] do
      assert {^refused, answer} = ask(c, :post, "operations", begin)
      assert inspect(answer) =~ why
      assert %{"result" => result} = nats(c, "begin", Map.put(begin, "id", "odd"))
      assert result in ["refused", "malformed", "error"]
    end

    assert {200, %{"operations" => []}} = ask(c, :get, "operations")
    for sim <- c.sims, do: refute(SimVehicle.state(sim).armed)
  end
end
