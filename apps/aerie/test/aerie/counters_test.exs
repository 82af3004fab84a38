defmodule Aerie.CountersTest do
  @moduledoc "A gateway just started shows its counters, with 0."
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Gateway
  alias Aerie.Gateway.Counters

  @root Path.expand("../../../..", __DIR__)

  setup do
    gateway = {__MODULE__, make_ref()}
    start_supervised!({Store, gateway: gateway, counters: Counters.all()})
    {:ok, gateway: gateway}
  end

  defp samples(gateway, name) do
    {^name, :counter, _help, samples} = List.keyfind(Aerie.Api.Metrics.families(gateway), name, 0)
    Map.new(samples)
  end

  test "each decision, type and result is there from the start, and counts from there", %{gateway: gateway} do
    decisions = samples(gateway, "gateway_policy_decisions_total")
    rules = [:rate, :audit | Aerie.Control.Policy.rules()]

    assert Map.keys(decisions) |> Enum.sort() ==
             Enum.sort([
               [decision: :allow, rule: nil] | for(rule <- rules, do: [decision: :deny, rule: rule])
             ])

    assert %{[type: "goto"] => 0, [type: "unknown"] => 0} =
             samples(gateway, "gateway_commands_received_total")

    assert %{[type: "arm", result: :timeout] => 0} = samples(gateway, "gateway_commands_executed_total")
    assert %{[interface: :mavlink, reason: :stalled] => 0} = samples(gateway, "gateway_clients_refused_total")
    assert %{[name: "journal.inbox_dropped"] => 0} = samples(gateway, "gateway_occurrences_total")

    for name <-
          ~w(gateway_policy_decisions_total gateway_commands_received_total gateway_commands_executed_total),
        {labels, n} <- samples(gateway, name),
        do: assert({labels, n} == {labels, 0})

    _ = Store.count(gateway, {:policy, :deny, :geofence})
    assert samples(gateway, "gateway_policy_decisions_total")[[decision: :deny, rule: :geofence]] == 1
  end

  test "they are few enough for each scrape, each once, and the gateway's store has them" do
    all = Counters.all()
    assert length(all) == length(Enum.uniq(all))
    assert length(all) < 1_200

    [{Store, options} | _parts] = Gateway.parts(:none, Aerie.Config.default())
    assert options[:counters] == all
  end

  test "every counter that the code names is in the table" do
    # Its value says whether links were started before, and is shown nowhere else.
    kept = ~r/Store\.count(?:_if_running)?\([\w.]+, (\{:\w+, :\w+\}|\{:\w+, :\w+, :\w+\}|:\w+)[,)]/

    named =
      for file <- Path.wildcard(Path.join(@root, "apps/*/lib/**/*.ex")),
          text = File.read!(file),
          text =~ "Store.count",
          [_all, counter] <- Regex.scan(kept, text),
          do: counter

    assert length(named) > 10
    shown = Enum.map(Counters.all(), &inspect/1)
    # It has a family of its own, which shows 0.
    assert Enum.uniq(named) -- shown == ["{:audit, :missed}"]
  end
end
