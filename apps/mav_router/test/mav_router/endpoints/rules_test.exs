defmodule MavRouter.Endpoints.RulesTest do
  @moduledoc "Rules that are changed at run time, while parts of the gateway are killed."
  use Aerie.LinkCase, async: true

  alias Aerie.Base.{Error, Names}
  alias Aerie.Base.Names.Successor
  alias MavRouter.Router

  # When a part dies, those after it start again, as in a whole gateway.
  defp start_gateway do
    gateway = make_ref()
    config = %{clients: []}

    children =
      for part <- [Aerie.Base.Store, Aerie.Base.PubSub, Router.Supervisor, MavRouter.Link.Supervisor],
          do:
            Successor.child_spec(
              {part, options(part, gateway, config) ++ [children: [clients(gateway, config)]]}
            )

    start = {Supervisor, :start_link, [children, [strategy: :rest_for_one]]}
    start_supervised!(%{id: gateway, type: :supervisor, start: start})
    gateway
  end

  @tag :capture_log
  test "what was changed of the rules survives the process and the router, is listed, and can be undone" do
    gateway = start_gateway()
    add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    limits = %{"ATTITUDE" => 4}
    client = %{url: "udpin:127.0.0.1:0", id: "gcs", rate_limits: limits, queue_kb: 64}
    {:ok, id} = MavRouter.Client.add(gateway, client)
    assert Router.changes(gateway) == %{}
    filter = %{block_messages: ["RAW_IMU"]}
    :ok = Router.configure(gateway, id, filter_out: filter, queue_frames: 5)
    :ok = Router.configure(gateway, id, rate_limits: nil)
    :ok = Router.configure(gateway, "radio", bytes_per_s: 1_000)

    changed = %{
      "gcs" => %{
        filter_out: %{now: filter, configured: nil},
        queue_frames: %{now: 5, configured: nil},
        rate_limits: %{now: nil, configured: limits}
      },
      "radio" => %{bytes_per_s: %{now: 1_000, configured: nil}}
    }

    assert Router.changes(gateway) == changed

    holds = fn ->
      tables = MavRouter.Tables.of(gateway)
      owner = &(tables && MavRouter.Endpoints.owner(tables, &1))

      match?(
        %{limits: nil, out: [_], queue: [max_bytes: 65_536, max_frames: 5]},
        owner.(id)
      ) and match?(%{bytes_per_s: 1_000}, owner.("radio"))
    end

    assert holds.()

    for {role, which} <- [{:link, id}, {:link, "radio"}, {:router, nil}] do
      pid = Names.whereis(gateway, role, which)
      Process.exit(pid, :kill)
      eventually(fn -> Names.whereis(gateway, role, which) not in [nil, pid] end)
      eventually(holds)
      eventually(fn -> Names.whereis(gateway, :link, "radio") end)
    end

    assert Router.changes(gateway) == changed
    :ok = Router.reset(gateway, id, [:rate_limits])
    assert %{limits: %{30 => 250_000}, out: [_]} = MavRouter.Endpoints.owner(MavRouter.Tables.of(gateway), id)
    :ok = Router.reset(gateway, id)
    assert Map.keys(Router.changes(gateway)) == ["radio"]

    assert %{out: nil, queue: [max_bytes: 65_536]} =
             MavRouter.Endpoints.owner(MavRouter.Tables.of(gateway), id)

    assert {:error, %Error{reason: {:invalid, words}}} = Router.configure(gateway, id, filter: filter)
    assert words =~ ":filter"
    assert {:error, %Error{reason: {:unknown, :owner, "nobody"}}} = Router.reset(gateway, "nobody")

    # What is removed and added again is as it is configured.
    :ok = MavRouter.Link.stop(gateway, "radio")
    assert Router.changes(gateway) == %{}
    add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    assert %{bytes_per_s: nil} = MavRouter.Endpoints.owner(MavRouter.Tables.of(gateway), "radio")
  end
end
