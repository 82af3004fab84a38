defmodule Aerie.Fleet.Shadow.Loop.Core do
  @moduledoc """
  The shadow loop of a vehicle without the process: `compare/2` compares and decides, `done/5` records the outcome of an
  attempt. Times are unix microseconds.

  Actions, to be carried out in order:

    * `{:set, path, version, value}` - set the field, and call `done/5` with the outcome
    * `{:withdraw, path}` - an interval is no longer desired
    * `{:report, report}` - the state of the fields has changed
  """

  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.{Attempts, Holds, Reconcile}
  alias Aerie.Fleet.Shadow.Document.Observed

  @enforce_keys [:vehicle, :holds, :attempts, :allow_arming]
  defstruct [:vehicle, :holds, :attempts, :allow_arming, :document, :boot_ms] ++
              [busy: [], intervals: [], report: %{}, active: []]

  @type t :: %__MODULE__{
          vehicle: String.t(),
          holds: Holds.t(),
          attempts: Attempts.t(),
          allow_arming: boolean(),
          document: Document.t(),
          boot_ms: non_neg_integer() | nil,
          busy: [Field.path()],
          intervals: [Field.path()],
          report: Reconcile.report(),
          active: [Holds.hold()]
        }

  @typedoc """
    * `:snapshot` - the vehicle's snapshot; `:commanded` - the last command
      (`Aerie.Control.Policy.Memory.RecentCommands`)
    * `:holds` - what holds the shadow besides those in charge of the vehicle: another gateway, no NATS, the configuration
    * `:beside` - see `Aerie.Fleet.Shadow.Document.Observed`
  """
  @type view :: %{
          now: integer(),
          snapshot: map(),
          commanded: Aerie.Control.Policy.Memory.RecentCommands.t() | nil,
          holds: [Holds.hold()],
          beside: Observed.beside()
        }
  @type action :: Reconcile.action() | {:withdraw, Field.path()} | {:report, Reconcile.report()}
  @type outcome :: :done | {:refused, reason :: String.t()}

  # A clock that is this much behind has restarted; a smaller step back is a frame out of order.
  @restart_ms 5_000

  @doc "A loop without a document. Options: `:hold_us`, `:max_tries`, `:allow_arming`."
  @spec new(String.t(), keyword()) :: t()
  def new(vehicle, options) do
    %__MODULE__{
      vehicle: vehicle,
      document: Document.new(vehicle),
      holds: Holds.new(Keyword.fetch!(options, :hold_us)),
      attempts: Attempts.new(Keyword.fetch!(options, :max_tries)),
      allow_arming: Keyword.fetch!(options, :allow_arming)
    }
  end

  @doc "Takes a document, unless it is older than the known one (Z5)."
  @spec desired(t(), Document.t()) :: t()
  def desired(core, document),
    do: if(document.version >= core.document.version, do: %{core | document: document}, else: core)

  @doc "The machine's clock was set by so many microseconds (`Aerie.Base.Timing.HostClock`). A field's expiry is a date, and follows the clock."
  @spec clock_set(t(), integer()) :: t()
  def clock_set(core, 0), do: core

  def clock_set(core, step),
    do: %{core | holds: Holds.moved(core.holds, step), attempts: Attempts.moved(core.attempts, step)}

  @doc "Whether anything is desired."
  @spec idle?(t()) :: boolean()
  def idle?(core), do: core.document.fields == %{} and core.intervals == [] and core.report == %{}

  @doc "Compares the vehicle with the document."
  @spec compare(t(), view()) :: {t(), [action()]}
  def compare(core, %{now: now, snapshot: snapshot} = view) do
    core = %{core | holds: Holds.observe(core.holds, snapshot, view.commanded, now)} |> rebooted(snapshot)
    desired = Document.live(core.document, now)
    paths = Map.keys(desired)
    tags = for {"tags", %{value: value}} <- desired, into: view.beside, do: {"tags", value}
    holds = view.holds ++ not_heard(snapshot) ++ Holds.active(core.holds, now)

    context = %{
      now: now,
      holds: holds,
      attempts: core.attempts,
      busy: core.busy,
      allow_arming: core.allow_arming
    }

    {set, report} = Reconcile.reconcile(desired, Observed.of(snapshot, paths, tags), context)
    agreeing = for {path, %{state: :converged}} <- report, do: path
    core = %{core | attempts: Attempts.agreed(core.attempts, agreeing, paths, now), active: holds}
    {core, withdrawn} = intervals(core, paths)
    {core, news} = news(core, report)
    {Enum.reduce(set, core, &busy(&1, &2, now)), withdrawn ++ set ++ news}
  end

  defp rebooted(core, %{time_boot_ms: boot_ms}) when is_integer(boot_ms) do
    restarted? =
      core.boot_ms != nil and boot_ms + @restart_ms < core.boot_ms and
        not MavCodec.Message.BootClock.wrapped?(core.boot_ms, boot_ms)

    attempts = if restarted?, do: Attempts.rebooted(core.attempts), else: core.attempts
    %{core | boot_ms: boot_ms, attempts: attempts}
  end

  defp rebooted(core, _snapshot), do: core

  # What somebody says in its name reaches nobody.
  defp not_heard(%{status: :online, collision: %{sign: "claim"}}), do: []

  defp not_heard(%{status: :online, collision: collision}) when collision != nil,
    do: [%{by: "collision", until: nil, why: "two vehicles have its system id"}]

  defp not_heard(%{status: :online}), do: []
  defp not_heard(%{status: status}), do: [%{by: "link", until: nil, why: "the vehicle is #{status}"}]

  defp intervals(core, paths) do
    wanted = for "intervals." <> _name = path <- paths, do: path
    {%{core | intervals: wanted}, for(path <- core.intervals -- wanted, do: {:withdraw, path})}
  end

  defp news(%{report: report} = core, report), do: {core, []}
  defp news(core, report), do: {%{core | report: report}, [{:report, report}]}

  defp busy({:set, path, _version, _value}, core, now) do
    touches? = Field.fetch!(path).permission != :telemetry

    %{
      core
      | busy: [path | core.busy],
        holds: if(touches?, do: Holds.acted(core.holds, now), else: core.holds)
    }
  end

  @doc "Records the end of an attempt: `:done` if the vehicle says so, or refused for a reason."
  @spec done(t(), Field.path(), version :: pos_integer(), outcome(), now :: integer()) :: t()
  def done(core, path, version, outcome, now) do
    reason = with {:refused, reason} <- outcome, do: reason, else: (:done -> nil)

    %{
      core
      | busy: List.delete(core.busy, path),
        attempts: Attempts.tried(core.attempts, path, version, reason, now)
    }
  end
end
