defmodule Aerie.System.ShadowTest do
  @moduledoc "The shadow through the whole gateway: simulated vehicles are made to agree, and nobody in charge of them is disturbed."
  use Aerie.SystemCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Control.{Commands, Missions, Params}
  alias Aerie.Fleet.Shadow
  alias Protocols.Mission.File.QgcPlan
  alias Protocols.Mission.{Item, Plan}

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key {"main", 1}
  @vehicle "VID-001"

  setup %{tmp_dir: folder} = context do
    overrides = %{
      "timeouts" => patient(),
      "shadow" => %{"dir" => Path.join(folder, "shadow"), "hold_s" => 1, "lease_s" => 2},
      "signing" => %{"dir" => Path.join(folder, "signing"), "keys" => keys(folder, context[:key])}
    }

    link = context[:link] || "udpin:127.0.0.1:0"
    %{gateway: gateway} = start_gateway(folder, links: [link], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    {:ok, sim} = SimVehicle.start_link([link: link] ++ fast_vehicle(context[:firmware] || :ardupilot))
    SimVehicle.await(sim, & &1.ready)
    await_standing(gateway)
    %{gateway: gateway, sim: sim}
  end

  defp keys(_folder, nil), do: []

  defp keys(folder, passphrase) do
    file = private_file(folder, "network.key", passphrase)
    [%{"key_file" => file}]
  end

  defp desire(gateway, desired), do: {:ok, _done} = Shadow.update(gateway, @vehicle, %{"desired" => desired})

  defp standing(gateway, path, state) do
    eventually(
      fn -> match?(%{^path => %{state: ^state}}, Shadow.report(gateway, @vehicle)) end,
      fn -> "#{path} #{state}; it is #{inspect(Shadow.report(gateway, @vehicle)[path])}" end
    )

    Shadow.report(gateway, @vehicle)[path]
  end

  defp command(gateway, type, params \\ %{}) do
    # Ten seconds, the usual deadline, are too few on a busy machine.
    deadline = System.os_time(:second) + 120

    {:ok, result} =
      Commands.submit(gateway, vehicle: @vehicle, type: type, params: params, deadline: deadline)

    result
  end

  defp plan do
    # Neither firmware keeps all of it.
    point = fn north ->
      %Item{
        command: 16,
        frame: 3,
        x: 473_977_420 + north,
        y: 85_455_940,
        z: 20.125,
        params: {2.5, 5.0, 1.0, 123.4}
      }
    end

    take_off = %{point.(0) | command: 22}

    corners =
      for {x, y} <- [{-9_000, -9_000}, {9_000, -9_000}, {9_000, 9_000}], do: {473_977_420 + x, 85_455_940 + y}

    QgcPlan.write(%Plan{
      items: [take_off, point.(2_000), point.(4_000)],
      fence: [{:inclusion, {:polygon, corners}}]
    })
  end

  for {firmware, mode, param} <- [
        {:ardupilot, "GUIDED", "WPNAV_SPEED"},
        {:px4, "AUTO_LOITER", "MIS_TAKEOFF_ALT"}
      ] do
    @tag firmware: firmware
    test "#{firmware}: parameters, fence, mission, mode, and message rates agree in the end, and stay so",
         context do
      %{gateway: gateway, sim: sim} = context
      {:ok, %{value: old}} = Params.get(gateway, @vehicle, unquote(param))
      {:ok, hash} = Shadow.put_plan(gateway, plan())

      desire(gateway, %{
        "params" => %{unquote(param) => old + 1},
        "geofence" => %{"plan" => hash},
        "mission" => %{"plan" => hash},
        "mode" => unquote(mode),
        "intervals" => %{"ATTITUDE" => 4},
        "tags" => ["survey"]
      })

      for path <- [
            "params.#{unquote(param)}",
            "geofence.plan",
            "mission.plan",
            "mode",
            "intervals.ATTITUDE",
            "tags"
          ],
          do: standing(gateway, path, :converged)

      new = old + 1
      assert {:ok, %{value: ^new}} = Params.get(gateway, @vehicle, unquote(param))
      assert SimVehicle.state(sim).mode == unquote(mode)
      assert {:ok, %{plan: %{items: [_, _, _]}}} = Missions.download(gateway, @vehicle, :mission)
      assert {:ok, %{plan: %{fence: [_zone]}}} = Missions.download(gateway, @vehicle, :fence)

      # The rate is measured, on a machine that stands still at times as too slow, and then it is asked for again.
      desire(gateway, %{"intervals" => nil})

      eventually(
        fn -> not is_map_key(Shadow.report(gateway, @vehicle), "intervals.ATTITUDE") end,
        "the rate is desired no more"
      )

      issued = Store.counter(gateway, {:shadow, :commands_issued})
      compared = Store.counter(gateway, {:shadow, :reconciliations})

      eventually(
        fn -> Store.counter(gateway, {:shadow, :reconciliations}) > compared + 3 end,
        "it was looked at again"
      )

      assert Store.counter(gateway, {:shadow, :commands_issued}) == issued
      conn = nats_client(gateway)

      eventually(
        fn ->
          with {:ok, text, _revision} <- Aerie.Fleet.Nats.KV.get(conn, "fleet_reported", "test.#{@vehicle}") do
            match?(
              %{"fields" => %{"mission.plan" => %{"state" => "converged"}}, "tags" => ["survey"]},
              JSON.decode!(text)
            )
          else
            _none -> false
          end
        end,
        "it is reported"
      )
    end
  end

  test "a plan without a fence does not remove the fence aboard", %{gateway: gateway} do
    {:ok, plan} = Missions.import(plan(), :plan)
    {:ok, %{status: :completed}} = Missions.upload(gateway, @vehicle, :fence, plan)
    {:ok, hash} = Shadow.put_plan(gateway, QgcPlan.write(%{plan | fence: []}))
    desire(gateway, %{"geofence" => %{"plan" => hash}})

    eventually(
      fn -> to_string(Shadow.report(gateway, @vehicle)["geofence.plan"][:why]) =~ "there is none in it" end,
      fn -> "it is refused; it is #{inspect(Shadow.report(gateway, @vehicle)["geofence.plan"])}" end
    )

    assert {:ok, %{plan: %{fence: [_zone]}}} = Missions.download(gateway, @vehicle, :fence)
    misspelt = String.replace(plan(), "geoFence", "geofence")
    assert {:error, {:invalid, text}} = Shadow.put_plan(gateway, misspelt)
    assert text =~ ~s(expected "geoFence")
  end

  test "the fence is switched on, and off again", %{gateway: gateway, sim: sim} do
    for {on?, value} <- [{true, 1.0}, {false, 0.0}] do
      desire(gateway, %{"geofence" => %{"enabled" => on?}})
      # The last report may still be that of the wish before.
      eventually(fn -> data(gateway, :health)[:fence_enabled] == on? end, "the fence is #{on?}")
      standing(gateway, "geofence.enabled", :converged)
      assert {:ok, %{value: there}} = Params.get(gateway, @vehicle, "FENCE_ENABLE")
      assert there == value
    end

    assert SimVehicle.state(sim).armed == false
  end

  @tag key: "a long passphrase of the network", link: "udpin:127.0.0.1:0?secure=true"
  test "a vehicle without a key gets the one that is kept for it, over a secure link", %{gateway: gateway} do
    refute match?(%{state: :verified}, MavRouter.Signing.vehicle(gateway, @key))
    desire(gateway, %{"signing" => true})
    standing(gateway, "signing", :converged)
    assert %{state: :verified} = MavRouter.Signing.vehicle(gateway, @key)
  end

  test "armed on the ground it is not sent off; in the air it agrees when the operator has let go, and a failsafe holds it",
       context do
    %{gateway: gateway, sim: sim} = context
    assert %{status: :completed} = command(gateway, "set_mode", %{mode: "GUIDED"})
    assert %{status: :completed} = command(gateway, "arm")
    desire(gateway, %{"mode" => "AUTO"})

    eventually(
      fn -> match?(%{"mode" => %{by: "ground"}}, Shadow.report(gateway, @vehicle)) end,
      "held by the ground"
    )

    {:ok, _done} = Shadow.delete(gateway, @vehicle)
    assert %{status: :completed} = command(gateway, "takeoff", %{altitude: 10})
    SimVehicle.await(sim, &(&1.alt_rel > 8))
    desire(gateway, %{"mode" => "LOITER"})
    # The operator's time is over.
    standing(gateway, "mode", :converged)
    assert SimVehicle.state(sim).mode == "LOITER"

    # By the vehicle itself, which nobody here commanded.
    SimVehicle.failsafe(sim, :battery)
    eventually(fn -> data(gateway, :mode)[:mode] != "LOITER" end, "the failsafe acts")
    # NATS may be away for a moment just then, which holds it too.
    eventually(
      fn ->
        match?(
          %{"mode" => %{state: :held, by: by}} when by in ["failsafe", "other"],
          Shadow.report(gateway, @vehicle)
        )
      end,
      "held by the failsafe"
    )
  end

  test "its loop, the documents and the whole tree may be killed: what is desired stays, and is done",
       context do
    %{gateway: gateway, sim: sim} = context
    desire(gateway, %{"mode" => "GUIDED"})
    standing(gateway, "mode", :converged)
    session = Names.whereis(gateway, :session, @key)
    Process.exit(Names.whereis(gateway, :shadow, @key), :kill)
    eventually(fn -> Names.whereis(gateway, :session, @key) not in [nil, session] end, "the tree restarted")
    documents = Names.whereis(gateway, :shadow_documents)
    Process.exit(documents, :kill)

    eventually(
      fn -> Names.whereis(gateway, :shadow_documents) not in [nil, documents] end,
      "the documents restarted"
    )

    desire(gateway, %{"mode" => "LOITER"})
    eventually(fn -> SimVehicle.state(sim).mode == "LOITER" end, "it is in LOITER")
    standing(gateway, "mode", :converged)
    assert {:ok, %{"version" => 2}} = Shadow.get(gateway, @vehicle)
  end

  test "at a bad link it agrees all the same, and refuses what the vehicle refuses", %{
    gateway: gateway,
    sim: sim
  } do
    :ok = SimVehicle.fault(sim, :loss, 0.25)
    desire(gateway, %{"params" => %{"WPNAV_SPEED" => 444, "NO_SUCH_PARAM" => 1}, "mode" => "GUIDED"})
    standing(gateway, "params.WPNAV_SPEED", :converged)
    assert %{why: "waits for params.NO_SUCH_PARAM"} = standing(gateway, "mode", :pending)
    desire(gateway, %{"params" => %{"NO_SUCH_PARAM" => nil}})
    standing(gateway, "mode", :converged)
  end
end
