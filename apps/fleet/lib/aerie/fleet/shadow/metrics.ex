defmodule Aerie.Fleet.Shadow.Metrics do
  @moduledoc """
  The shadow's counters in the read model, their metrics, and its telemetry:

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :shadow, :updated]` | `version` | `gateway`, `vehicle`, `actor`, `via`, `set`, `removed` (numbers of fields) |
  | `[:aerie, :shadow, :refused]` | `count` (1) | `gateway`, `vehicle`, `actor`, `via`, `reason` |
  | `[:aerie, :shadow, :set]` | `count` (1) | `gateway`, `vehicle`, `field`, `outcome` (`done` or `refused`), `reason` |
  """

  alias Aerie.Base.{Names, Store}

  @type metric :: %{
          name: String.t(),
          type: :counter | :gauge,
          help: String.t(),
          samples: [{[{atom(), String.t()}], number()}]
        }

  @counters [
    reconciliations:
      {"gateway_shadow_reconciliations_total", "Comparisons of a desired state with its vehicle."},
    commands_issued: {"gateway_shadow_commands_issued_total", "Fields that the shadow tried to set."},
    updates: {"gateway_shadow_updates_total", "Changes of desired states."},
    updates_refused: {"gateway_shadow_updates_refused_total", "Changes of desired states that were refused."},
    conflicts:
      {"gateway_shadow_conflicts_total", "Writes that lost a race and were tried again on the new value."},
    documents_refused:
      {"gateway_shadow_documents_refused_total",
       "Documents in the bucket that no gateway with this key wrote, or that are older than the known one."},
    leases_refused:
      {"gateway_shadow_leases_refused_total",
       "Leases and signs of life in NATS that no gateway with this key wrote, or that are older than the known ones."},
    reports_shortened:
      {"gateway_shadow_reports_shortened_total",
       "Reported documents that were too large and left fields out (omitted_fields)."},
    dropped:
      {"gateway_shadow_requests_dropped_total", "Requests over NATS dropped because too many came at once."}
  ]
  @states [:converged, :pending, :held, :refused]

  @doc "Increments a counter."
  @spec count(Names.gateway(), atom(), non_neg_integer()) :: :ok
  def count(gateway, what, n \\ 1) do
    _ = Store.count(gateway, {:shadow, what}, n)
    :ok
  end

  @doc "Whether a counter of the read model belongs to the shadow."
  @spec own?(term()) :: boolean()
  def own?({:shadow, _what}), do: true
  def own?(_other), do: false

  @doc "The metrics; `reports` are the last ones of all vehicles."
  @spec all(Names.gateway(), [map()]) :: [metric()]
  def all(gateway, reports) do
    counters =
      for {key, {name, help}} <- @counters do
        %{name: name, type: :counter, help: help, samples: [{[], Store.counter(gateway, {:shadow, key})}]}
      end

    states = for report <- reports, {_path, %{state: state}} <- report, do: state
    found = Enum.frequencies(states)
    samples = for state <- @states, do: {[state: Atom.to_string(state)], Map.get(found, state, 0)}
    help = "Desired fields of all vehicles, by state."
    counters ++ [%{name: "gateway_shadow_fields", type: :gauge, help: help, samples: samples}]
  end
end
