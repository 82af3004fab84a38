defmodule Aerie.Control.CommandExecutor.Job do
  @moduledoc """
  A command in the executor: its steps, and how far the first of them is.

  Phases of a step:

    * `:queued` - it waits for its turn; nothing of the step was sent
    * `:turn` - it is its turn, but our session may ask the same just now (`shared?`)
    * `:sent` - it was sent; an answer, or the vehicle's state, is awaited
    * `:running` - the vehicle reports progress (C4)
    * `:accepted` - the vehicle accepted it; its state is to show it
    * `:observing` - no answer came; its state may show it
    * `:instead` - the vehicle wants another form; answers to the former one are let pass before it is sent (C8)
    * `:cancelling` - the vehicle was asked to cancel it
    * `:refused` - the vehicle refused it, and may say why
    * `:given_up` - its time is up; an answer may still come
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Vehicle.Protocol.{Condition, Step, Vehicle}

  @enforce_keys [:command, :until, :steps, :since]
  defstruct [
    :command,
    :until,
    :steps,
    :since,
    :due,
    :prolonged,
    :first_sent,
    :last_sent,
    :accepted_at,
    :before,
    :refusal,
    :mode,
    ambiguous?: false,
    phase: :queued,
    sends: 0,
    all_sends: 0,
    cancels: 0,
    done: 0
  ]

  @type phase ::
          :queued
          | :turn
          | :sent
          | :running
          | :accepted
          | :observing
          | :instead
          | :cancelling
          | :refused
          | :given_up

  @typedoc """
    * `:until` - the deadline; `:since` - when it was submitted; `:due` - when something has to be done, all in the time of the
      events; `:prolonged` - a time in `:due` that was put off already, because the gateway had stood still
    * `:before` - whether the state showed it before it was sent; nil: not known
    * `:mode` - the vehicle's mode when it was submitted
    * `:refusal` - what a repetition was answered, or what its result will be in the phase `:refused`
    * `:ambiguous?` - a late answer to another command of the same key may be taken for one to this
    * `:sends` - of this step, `:all_sends` of the command; `:cancels` - how often a cancellation was sent; `:done` - how many steps are behind it
  """
  @type t :: %__MODULE__{
          command: Command.t(),
          until: integer(),
          steps: [Step.t(), ...],
          since: integer(),
          due: integer() | nil,
          prolonged: integer() | nil,
          first_sent: integer() | nil,
          last_sent: integer() | nil,
          accepted_at: integer() | nil,
          before: boolean() | nil,
          mode: String.t() | nil,
          refusal: {Result.status() | :busy, String.t()} | nil,
          ambiguous?: boolean(),
          phase: phase(),
          sends: non_neg_integer(),
          all_sends: non_neg_integer(),
          cancels: non_neg_integer(),
          done: non_neg_integer()
        }

  @spec id(t()) :: String.t()
  def id(job), do: job.command.id

  @spec step(t()) :: Step.t()
  def step(%{steps: [step | _others]}), do: step

  @spec key(t()) :: term()
  def key(job), do: step(job).key

  @doc "Whether anything of it reached the link, so that the vehicle may have done it."
  @spec sent?(t()) :: boolean()
  def sent?(job), do: job.sends > 0

  @doc "The step was sent now; `before` is looked up the first time."
  @spec sent(t(), Vehicle.t(), now :: integer(), due :: integer()) :: t()
  def sent(job, vehicle, now, due) do
    job =
      if job.sends == 0, do: %{job | first_sent: now, before: before(step(job).confirm, vehicle)}, else: job

    %{job | phase: :sent, last_sent: now, due: due, sends: job.sends + 1, all_sends: job.all_sends + 1}
  end

  defp before(nil, _vehicle), do: nil

  defp before(condition, vehicle) do
    if Condition.seen(condition, vehicle), do: Condition.met?(condition, vehicle)
  end

  @doc """
  A job that was sent, and the others: the state that shows that it was done proves nothing for either of two in flight that have
  the same one to show, until the vehicle has accepted it.
  """
  @spec doubt(t(), %{String.t() => t()}) :: {t(), %{String.t() => t()}}
  def doubt(job, jobs) do
    condition = step(job).confirm

    rivals =
      for {id, other} <- jobs,
          condition != nil,
          id != id(job),
          sent?(other),
          step(other).confirm == condition,
          do: id

    if rivals == [],
      do: {job, jobs},
      else: {%{job | before: true}, Enum.reduce(rivals, jobs, &put_in(&2[&1].before, true))}
  end

  @doc "The job at its next step; nil when there is none."
  @spec next(t()) :: t() | nil
  def next(%{steps: [_last]}), do: nil

  def next(%{steps: [_done | steps]} = job) do
    %{
      job
      | steps: steps,
        done: job.done + 1,
        phase: :queued,
        sends: 0,
        due: nil,
        first_sent: nil,
        last_sent: nil,
        accepted_at: nil,
        before: nil,
        refusal: nil
    }
  end

  @doc """
  Whether the vehicle's state shows now that it did the step. What it showed before as well proves nothing until it was
  heard again after the vehicle accepted.
  """
  @spec confirmed?(t(), Vehicle.t()) :: boolean()
  def confirmed?(%{steps: [%{confirm: nil} | _others]}, _vehicle), do: false

  def confirmed?(%{steps: [%{confirm: condition} | _others]} = job, vehicle) do
    seen = Condition.seen(condition, vehicle)

    met?(job, vehicle) and seen != nil and
      ((job.before == false and seen >= job.first_sent) or
         (job.accepted_at != nil and seen >= job.accepted_at))
  end

  @doc "Whether the condition of the step is met; an earlier boot that is only heard of now does not count."
  @spec met?(t(), Vehicle.t()) :: boolean()
  def met?(%{steps: [%{confirm: {:booted, _before} = condition} | _others]} = job, vehicle) do
    Condition.met?(condition, vehicle) and (vehicle.booted_at == nil or vehicle.booted_at > job.first_sent)
  end

  def met?(%{steps: [%{confirm: condition} | _others]}, vehicle), do: Condition.met?(condition, vehicle)

  @doc "The result of the job."
  @spec result(t(), Result.status(), String.t() | nil, now :: integer()) :: Result.t()
  def result(job, status, reason, now) do
    Result.new(id(job), status, reason, %{
      "ms" => div(now - job.since, 1000),
      "sent" => job.all_sends,
      "acknowledged" => job.accepted_at != nil
    })
  end
end
