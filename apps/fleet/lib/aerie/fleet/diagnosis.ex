defmodule Aerie.Fleet.Diagnosis do
  @moduledoc """
  Names what is wrong with links, vehicles and the gateway itself, with the evidence and what to do.

      Aerie.Fleet.Diagnosis.list(:default)

  The rules are pure: `step/2` takes the facts of a moment (`Aerie.Fleet.Diagnosis.Observations`), adds what changed since earlier moments
  (`Aerie.Fleet.Diagnosis.Trend`), and asks each module in `rules/`. `Aerie.Fleet.Diagnosis.Server` holds the value for a gateway, so that many
  callers share one look. The README in this folder lists the conditions.
  """

  alias Aerie.Fleet.Diagnosis.{Condition, Observations, Rules, Server, Trend}

  # A gateway with a thousand bad links has one problem, not a thousand.
  @max_conditions 200

  @rules [Rules.Serial, Rules.Links, Rules.Traffic, Rules.Vehicles, Rules.Gateway]

  defstruct trend: Trend.new(), since: %{}

  @typedoc "`since`: when each present condition was first noticed (unix us)."
  @type t :: %__MODULE__{trend: Trend.t(), since: %{{atom(), Condition.subject()} => integer()}}

  @doc "The present conditions of a gateway, the most serious first, at most two seconds old; `[]` if it does not run."
  @spec list(Aerie.Base.Names.gateway()) :: [Condition.t()]
  def list(gateway) do
    case Server.fetch(gateway) do
      {:ok, conditions} -> conditions
      :error -> []
    end
  end

  @doc "What is shown of a condition."
  @spec fields() :: [Aerie.Base.Json.Object.t()]
  defdelegate fields, to: Condition

  @doc "The same as values of JSON."
  @spec plain(Aerie.Base.Names.gateway()) :: [map()]
  def plain(gateway), do: Enum.map(list(gateway), &Condition.plain/1)

  @doc "The process that looks, for a supervisor. Options: `:gateway`."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  defdelegate child_spec(options), to: Server

  @doc "A diagnosis that has seen no facts."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  The conditions that facts show. Rules about growing counters need two calls at least ten seconds apart; calls between them do no harm.
  """
  @spec step(t(), Observations.t()) :: {[Condition.t()], t()}
  def step(%__MODULE__{} = diagnosis, facts) do
    {facts, trend} = Trend.step(diagnosis.trend, facts)

    conditions =
      @rules
      |> Enum.flat_map(&check(&1, facts))
      |> Enum.uniq_by(&key/1)
      |> Enum.sort_by(&Condition.rank/1)
      |> Enum.take(@max_conditions)
      |> Enum.map(&%{&1 | since: Map.get(diagnosis.since, key(&1), facts.now)})

    {conditions, %{diagnosis | trend: trend, since: Map.new(conditions, &{key(&1), &1.since})}}
  end

  # A rule that fails on an odd snapshot must not hide what the others find.
  defp check(rules, facts) do
    rules.check(facts)
  rescue
    error ->
      fields = [
        title: "a rule of the diagnosis failed",
        evidence: ["#{inspect(rules)}: #{Exception.message(error)}"],
        mend: "Report it, with the evidence; the other rules are not affected."
      ]

      [Condition.new(:rule_failed, :notice, :gateway, fields)]
  end

  defp key(%{name: name, subject: subject}), do: {name, subject}

  @doc "The names of all conditions, with their meanings."
  @spec names() :: [{atom(), String.t()}]
  def names do
    @rules
    |> Enum.flat_map(& &1.names())
    |> Enum.uniq_by(&elem(&1, 0))
    |> Enum.concat(rule_failed: "a rule of the diagnosis itself failed")
  end
end
