defmodule Aerie.Bridge.Connection.Machine do
  @moduledoc """
  When to connect to which server: the decisions of `Aerie.Bridge.Connection`, without a clock or a socket.

  `handle/2` takes what happened and gives the new machine and what to do:

    * `{:connect, url}` - make one attempt
    * `{:timer, ms}` - send `:retry` after this time; `:cancel_timer`
    * `{:log, level, text}`

  The first retry comes at once, then pauses grow from `min` to `max` with jitter, and each attempt takes the next URL. A
  connection that did not last `stable_ms` counts as one more failure, so that a server which accepts and then closes
  is not asked in a busy loop.
  """

  alias Aerie.Bridge.Backoff

  @enforce_keys [:min, :max]
  defstruct [:min, :max, urls: [], phase: :idle, failures: 0, attempts: 0, stable_ms: 5_000, last_reason: nil]

  @type t :: %__MODULE__{
          min: pos_integer(),
          max: pos_integer(),
          urls: [String.t()],
          phase: :idle | :connecting | :waiting | :up,
          failures: non_neg_integer(),
          attempts: non_neg_integer(),
          stable_ms: pos_integer(),
          last_reason: String.t() | nil
        }

  @type event ::
          {:urls, [String.t()]}
          | :connected
          | {:failed, String.t()}
          | {:closed, String.t(), up_ms :: non_neg_integer()}
          | :retry

  @type action ::
          {:connect, String.t()}
          | {:timer, non_neg_integer()}
          | :cancel_timer
          | {:log, Logger.level(), String.t()}

  @doc "A machine that knows no server yet. `min` and `max`: limits of the pauses, ms."
  @spec new(pos_integer(), pos_integer()) :: t()
  def new(min, max), do: %__MODULE__{min: min, max: max}

  @doc "Something happened."
  @spec handle(t(), event()) :: {t(), [action()]}
  # New servers, or the word that ours has just come up: there is no reason to wait any longer.
  def handle(%{phase: phase} = machine, {:urls, urls}) when phase in [:idle, :waiting] and urls != [] do
    machine = %{machine | urls: urls, failures: 0, attempts: 0}
    {machine, actions} = connect(machine)
    {machine, [:cancel_timer | actions]}
  end

  # While an attempt or a connection lasts, an empty list says nothing new: the server is gone, which that will notice.
  def handle(machine, {:urls, []}), do: {machine, []}
  def handle(machine, {:urls, urls}), do: {%{machine | urls: urls}, []}

  def handle(%{phase: :connecting} = machine, :connected) do
    {%{machine | phase: :up, last_reason: nil}, [{:log, :info, "connected to NATS at #{current(machine)}"}]}
  end

  def handle(%{phase: :connecting} = machine, {:failed, reason}) do
    wait(machine, machine.failures + 1, "cannot connect to NATS at #{current(machine)}: #{reason}")
  end

  def handle(%{phase: :up} = machine, {:closed, reason, up_ms}) do
    failures = if up_ms >= machine.stable_ms, do: 1, else: machine.failures + 1
    wait(machine, failures, "the connection to NATS is lost: #{reason}")
  end

  def handle(%{phase: :waiting} = machine, :retry), do: connect(machine)

  # A late timer or message of a connection that is gone already.
  def handle(machine, _event), do: {machine, []}

  defp connect(machine) do
    machine = %{machine | phase: :connecting, attempts: machine.attempts + 1}
    {machine, [{:connect, current(machine)}]}
  end

  defp current(machine), do: Enum.at(machine.urls, rem(machine.attempts - 1, length(machine.urls)))

  defp wait(machine, failures, reason) do
    # Said once, not at every attempt of a long night.
    log = if reason == machine.last_reason, do: [], else: [{:log, :warning, reason}]
    delay = Backoff.delay(failures, machine.min, machine.max)
    {%{machine | phase: :waiting, failures: failures, last_reason: reason}, log ++ [{:timer, delay}]}
  end
end
