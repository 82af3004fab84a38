defmodule Aerie.Fleet.RemoteTest do
  @moduledoc """
  A hub whose other gateway is the test, on a real nats-server: what it shows of it, and what becomes of commands.
  """
  use Aerie.BridgeCase, async: true

  import Aerie.CommandCase, only: [start_part: 3, commands: 1, audit: 1]

  alias Aerie.Base.Names
  alias Aerie.Control.{Commands, Missions, Policy}
  alias Aerie.Fleet.Remote
  alias Aerie.LinkCase
  alias Protocols.Mission.Item
  alias Aerie.Fleet.Remote.Table, as: Table

  @moduletag :tmp_dir
  @moduletag :capture_log
  @operator %{name: "ops", role: :operator, permissions: []}

  setup %{tmp_dir: dir} = context do
    gateway = start_bridge(config(dir))
    url = await_up(gateway)

    sections = %{
      policy: %{audit: %{dir: Path.join(dir, "audit"), max_mb: 8, required: true}},
      commands: commands(dir)
    }

    start_part(Policy.Store.Supervisor, gateway, sections)
    options = LinkCase.options(Commands.Supervisor, gateway, sections) ++ [gateways: Remote]

    start_supervised!(%{
      id: :commands,
      start: {Commands.Supervisor, :start_link, [options]},
      type: :supervisor
    })

    {:ok, settings} =
      Remote.Settings.new(%{
        "environment" => "test",
        "nats" => %{"mode" => "embedded"},
        "remote" => %{
          "enabled" => true,
          "lost_s" => context[:lost_s] || 600,
          "max_vehicles" => context[:max] || 100,
          "announce_s" => 0.2
        }
      })

    start_supervised!({Remote.Supervisor, gateway: gateway, settings: settings})
    conn = client(url)

    # The answer shows that the listener's subscription is known to the server. And it has read what the stream had, so
    # that it takes nothing twice.
    eventually(fn ->
      listener = Names.whereis(gateway, :remote_listener)
      %{conn: conn, tasks: tasks} = :sys.get_state(listener, Aerie.Patience.ms())
      conn != nil and Task.Supervisor.children(tasks) == []
    end)

    %{gateway: gateway, conn: conn}
  end

  defp tell(conn, id, group, data, gateway \\ "gateway-far") do
    now = System.os_time(:microsecond)
    body = Bridge.Message.state(id, group, data, nil, now, %{epoch: 3, gateway: gateway})
    :ok = Gnat.pub(conn, "fleet.test.#{id}.state.#{group}", body)
  end

  @facts %{
    network: "main",
    system_id: 9,
    autopilot: "px4",
    type: "copter",
    firmware: nil,
    status: "online",
    silent_s: 0.1
  }

  defp known(%{gateway: gateway, conn: conn}, id \\ "VID-009") do
    eventually(fn ->
      tell(conn, id, "gateway", @facts)
      tell(conn, id, "mode", %{mode: "AUTO_LOITER", armed: true, in_air: true})
      match?(%{status: :online, groups: %{mode: _}}, Fleet.vehicle(gateway, id))
    end)
  end

  # The test answers the next request for the vehicle.
  defp serve(%{conn: conn}, answer, subject \\ "cmd.*") do
    test = self()

    start_supervised!(
      {Task,
       fn ->
         {:ok, _sid} = Gnat.sub(conn, self(), "fleet.test.VID-009.#{subject}")
         {:ok, _known} = Gnat.request(conn, "$JS.API.INFO", "")
         send(test, :serving)

         receive do
           {:msg, message} -> answer.(message, JSON.decode!(message.body))
         end

         receive do: (:never -> :ok)
       end},
      id: make_ref()
    )

    assert_receive :serving
  end

  defp command(gateway, type, more \\ []) do
    fields = Keyword.merge([vehicle: "VID-009", type: type, as: @operator, via: "rest"], more)
    {:ok, result} = Commands.submit(gateway, fields)
    result
  end

  test "a command goes to the other gateway with its id, deadline and source; progress and result come back",
       context do
    %{gateway: gateway, conn: conn} = context
    known(context)
    test = self()

    serve(context, fn message, body ->
      send(test, {:asked, self(), message.topic, body})

      Gnat.pub(
        conn,
        message.topic <> ".progress.r1",
        JSON.encode!(%{"progress" => 0.5, "text" => "half", "odd" => 1})
      )

      receive do: (:go_on -> :ok)

      Gnat.pub(
        conn,
        message.reply_to,
        JSON.encode!(%{"id" => "r1", "result" => "completed", "reason" => nil, "retries" => 2})
      )
    end)

    task = Task.async(fn -> command(gateway, "hold", id: "r1", progress: test) end)
    assert_receive {:asked, server, "fleet.test.VID-009.cmd.hold", body}
    assert %{"id" => "r1", "source" => "ops by rest", "deadline" => deadline} = body
    assert {:ok, _time, 0} = DateTime.from_iso8601(deadline)
    assert_receive {:command_progress, nil, "r1", %{"progress" => 0.5, "text" => "half"} = told}
    refute is_map_key(told, "odd")
    send(server, :go_on)

    assert %{
             status: :completed,
             details: %{"gateway" => "gateway-far", "retries" => 2, "vehicle" => "VID-009"}
           } =
             Task.await(task, Aerie.Patience.ms())

    # From the ledger: nobody is asked again.
    assert %{status: :completed} = command(gateway, "hold", id: "r1")

    assert Enum.any?(
             audit(context.tmp_dir),
             &match?(%{"type" => "result", "id" => "r1", "result" => "completed"}, &1)
           )
  end

  test "a transfer without a time limit has the other gateway's, by the length of what is sent", context do
    known(context)
    test = self()

    plan = %Protocols.Mission.Plan{
      items: for(n <- 1..720, do: %Item{command: 16, frame: 3, x: n, y: n, z: 20.0})
    }

    serve_plan = fn ->
      serve(
        context,
        fn message, body ->
          send(test, {:asked, body})

          Gnat.pub(
            message.gnat,
            message.reply_to,
            JSON.encode!(%{"id" => body["id"], "result" => "completed"})
          )
        end,
        "mission.*"
      )
    end

    for {more, limit} <- [{[], nil}, {[timeout_ms: 90_000], 90}] do
      serve_plan.()
      options = [as: %{name: "ops", role: :admin, permissions: []}] ++ more

      assert {:ok, %{status: :completed}} =
               Missions.upload(context.gateway, "VID-009", :mission, plan, options)

      assert_receive {:asked, body}
      if limit, do: assert_in_delta(body["timeout"], limit, 60), else: refute(is_map_key(body, "timeout"))
      serve_plan.()
      assert {:error, _no_plan} = Missions.download(context.gateway, "VID-009", :mission, options)
      assert_receive {:asked, body}
      assert body["timeout"] == limit
    end
  end

  test "nobody listens: unreachable, and nothing was sent", %{gateway: gateway} = context do
    known(context)
    assert %{status: :failed, reason: why, details: %{"rule" => "unreachable"}} = command(gateway, "hold")
    assert why =~ "no gateway listens"
    assert why =~ "gateway-far"
  end

  @tag lost_s: 1
  test "the other gateway falls silent while a command is under way: unknown",
       %{gateway: gateway} = context do
    serve(context, fn _message, _body -> :silent end)

    # On a busy machine it is lost before the command is sent.
    result =
      eventually(fn ->
        known(context)
        result = command(gateway, "hold")
        not match?(%{status: :failed, details: %{"rule" => "unreachable"}}, result) && result
      end)

    assert %{status: :unknown, reason: why} = result
    assert why =~ "silent"
    assert %{status: :lost} = Fleet.vehicle(gateway, "VID-009")
    assert %{status: :failed, details: %{"rule" => "unreachable"}} = command(gateway, "hold")
  end

  test "an invalid answer is unknown; the hub's own policy decides first",
       %{gateway: gateway} = context do
    known(context)
    serve(context, fn message, _body -> Gnat.pub(message.gnat, message.reply_to, "[]") end)
    assert %{status: :unknown} = command(gateway, "hold")
    assert %{status: :denied, details: %{"rule" => "role"}} = command(gateway, "reboot")
    assert %{status: :rejected} = command(gateway, "hold", vehicle: "VID-404")
  end

  test "a command that came over NATS is not passed on", %{gateway: gateway} = context do
    known(context)
    assert %{status: :rejected, reason: "there is no vehicle VID-009"} = command(gateway, "hold", via: "nats")
  end

  @tag max: 3
  test "made-up vehicles and bytes cost no more than their bound; a lost vehicle makes room", context do
    %{gateway: gateway, conn: conn} = context
    known(context)
    for n <- 1..200, do: tell(conn, "FAKE-#{n}", "gateway", @facts)
    for _n <- 1..100, do: Gnat.pub(conn, "fleet.test.FAKE.state.gps", :crypto.strong_rand_bytes(200))
    eventually(fn -> Store.counter(gateway, {:remote, :malformed}) == 100 end)
    assert map_size(Table.vehicles(gateway, System.os_time(:microsecond))) == 3
    assert Store.counter(gateway, {:remote, :full}) == 198
    tell(conn, "FAKE-1", "gateway", %{@facts | status: "lost"})

    eventually(fn ->
      tell(conn, "NEW-1", "gateway", @facts)
      Fleet.vehicle(gateway, "NEW-1") != nil
    end)

    assert Fleet.vehicle(gateway, "FAKE-1") == nil
    assert Fleet.vehicle(gateway, "VID-009") != nil
  end

  test "a clock that is hours off makes no value old or new", %{gateway: gateway, conn: conn} do
    skew = -7_200 * 1_000_000
    now = System.os_time(:microsecond)

    put = fn group, data ->
      body =
        Bridge.Message.state("VID-009", group, data, nil, System.os_time(:microsecond) + skew, %{
          epoch: 3,
          gateway: "g"
        })

      Gnat.pub(conn, "fleet.test.VID-009.state.#{group}", body)
    end

    eventually(fn ->
      put.("gateway", @facts)
      put.("gps", %{fix: 3})

      with %{groups: %{gps: %{at: at}}} <- Fleet.vehicle(gateway, "VID-009"),
           do: at > now - 60_000_000,
           else: (_ -> false)
    end)
  end

  test "what is said again after a cut is as old as it says, and no sign of life",
       %{gateway: gateway} = context do
    old = System.os_time(:microsecond) - 600_000_000

    # A message that was two seconds under way, as on a busy machine, shows another clock: then another vehicle is
    # tried.
    eventually(fn ->
      id = "VID-#{System.unique_integer([:positive])}"
      known(context, id)

      for {group, data} <- [{"gateway", @facts}, {"gps", %{fix: 3}}, {"battery", %{remaining: 50.0}}] do
        body = Bridge.Message.state(id, group, data, nil, old, %{epoch: 3, gateway: "gateway-far"})
        headers = [{"Aerie-Backfill", "true"}]
        :ok = Gnat.pub(context.conn, "fleet.test.#{id}.state.#{group}", body, headers: headers)
      end

      %{groups: %{gps: %{at: at}}} =
        eventually(fn ->
          with %{groups: %{gps: _, battery: _}} = vehicle <- Fleet.vehicle(gateway, id),
               do: vehicle,
               else: (_ -> nil)
        end)

      abs(at - old) <= 1_000
    end)
  end
end
