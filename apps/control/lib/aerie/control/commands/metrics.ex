defmodule Aerie.Control.Commands.Metrics do
  @moduledoc "Counters of commands in the read model, and the metrics that they make."

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.{Result, Types}

  # Seconds. The last bucket is all.
  @buckets [0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0]

  @typedoc "A sample of a histogram has the end of its name in front."
  @type sample :: {[{atom(), String.t()}], number()} | {String.t(), [{atom(), String.t()}], number()}
  @type metric :: %{name: String.t(), type: :counter | :histogram, help: String.t(), samples: [sample()]}

  @doc """
  The counters that are there from the start: a rate sees their first event. Not those of refusals, which are all pairs of a type and a rule, and
  would be some thousand lines of each scrape; `gateway_policy_decisions_total` has each rule.
  """
  @spec counters() :: [{:commands, tuple()}]
  def counters do
    types = ["unknown" | Intent.raw()] ++ Enum.map(Types.all(), & &1.name)
    statuses = Enum.map(Result.table(), &elem(&1, 0))

    for(type <- types, do: {:commands, {:received, type}}) ++
      for(type <- types, status <- statuses, do: {:commands, {:executed, type, status}})
  end

  @doc "A command of the table (or `\"unknown\"`) has come."
  @spec received(Names.gateway(), String.t()) :: :ok
  def received(gateway, type), do: count(gateway, {:received, type})

  @doc "A command has its result, so many microseconds after it came; nil: that is not known."
  @spec executed(Names.gateway(), String.t(), Result.status(), non_neg_integer() | nil) :: :ok
  def executed(gateway, type, status, us) do
    count(gateway, {:executed, type, status})

    if us do
      count(gateway, {:us, type}, us)
      count(gateway, {:bucket, type, Enum.find(@buckets, :inf, &(us <= &1 * 1_000_000))})
    end

    :ok
  end

  @doc "A command was refused by a rule."
  @spec refused(Names.gateway(), String.t(), atom()) :: :ok
  def refused(gateway, type, rule), do: count(gateway, {:refused, type, rule})

  @doc "Whether a counter of the read model is one of these."
  @spec own?(term()) :: boolean()
  def own?({:commands, _what}), do: true
  def own?(_other), do: false

  @doc "The metrics."
  @spec all(Names.gateway()) :: [metric()]
  def all(gateway) do
    counters = for {{:commands, what}, n} <- Store.counters(gateway), into: %{}, do: {what, n}

    [
      %{
        name: "gateway_commands_received_total",
        type: :counter,
        help: "Commands that came, by type; unknown: no command of the table.",
        samples: Enum.sort(for {{:received, type}, n} <- counters, do: {[type: type], n})
      },
      %{
        name: "gateway_commands_executed_total",
        type: :counter,
        help: "Commands that have their result, by type and result.",
        samples:
          Enum.sort(for {{:executed, type, status}, n} <- counters, do: {[type: type, result: status], n})
      },
      %{
        name: "gateway_commands_refused_total",
        type: :counter,
        help: "Commands that were not carried out, by the rule that refused them.",
        samples: Enum.sort(for {{:refused, type, rule}, n} <- counters, do: {[type: type, rule: rule], n})
      },
      %{
        name: "gateway_command_latency_seconds",
        type: :histogram,
        help: "Time from a command's arrival to its result, for those that reached a vehicle.",
        samples:
          for({{:us, type}, us} <- Enum.sort(counters), sample <- histogram(type, us, counters), do: sample)
      }
    ]
  end

  defp histogram(type, us, counters) do
    {buckets, total} =
      Enum.map_reduce(@buckets ++ [:inf], 0, fn bucket, total ->
        total = total + Map.get(counters, {:bucket, type, bucket}, 0)
        {{"_bucket", [type: type, le: if(bucket == :inf, do: "+Inf", else: "#{bucket}")], total}, total}
      end)

    buckets ++ [{"_sum", [type: type], us / 1_000_000}, {"_count", [type: type], total}]
  end

  defp count(gateway, what, n \\ 1) do
    _ = Store.count(gateway, {:commands, what}, n)
    :ok
  end
end
