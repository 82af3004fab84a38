defmodule Aerie.Fleet.Bridge.Connection.Machine do
  @moduledoc """
  Decides when to connect to which server, for `Aerie.Fleet.Bridge.Connection`. Pure.

  `handle/2` takes an event and returns the new machine and actions:

    * `{:connect, url}` - make one attempt
    * `{:timer, ms}` - send `:retry` after this time; `:cancel_timer`
    * `{:log, level, text}`

  The first retry is immediate, then pauses grow from `min` to `max` with jitter. Each attempt takes the next URL. A connection
  that lasted less than `stable_ms` counts as a failure, so that a server that accepts and then closes causes no busy loop.
  """

  alias Aerie.Base.Timing.Backoff

  @enforce_keys [:backoff]
  defstruct [:backoff, urls: [], phase: :idle, attempts: 0, stable_ms: 5_000, failures: %{}]

  @type t :: %__MODULE__{
          backoff: Backoff.t(),
          urls: [String.t()],
          phase: :idle | :connecting | :waiting | :up,
          attempts: non_neg_integer(),
          stable_ms: pos_integer(),
          failures: %{(url :: String.t()) => String.t()}
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

  @doc "A machine without a server. `min` and `max` are the limits of the pauses, in ms."
  @spec new(pos_integer(), pos_integer()) :: t()
  def new(min, max), do: %__MODULE__{backoff: Backoff.new(min, max)}

  @doc "Why there is no connection: what became of the last attempt at each server, in words. Nil before the first one, and with a connection."
  @spec problem(t()) :: String.t() | nil
  def problem(machine) do
    texts = for url <- machine.urls, text = machine.failures[url], do: text
    if texts != [], do: Enum.join(texts, "; ")
  end

  @doc "Handles an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  # New URLs, or the embedded server has just come up: no reason to wait.
  def handle(%{phase: phase} = machine, {:urls, urls}) when phase in [:idle, :waiting] and urls != [] do
    machine = %{machine | urls: urls, backoff: Backoff.reset(machine.backoff), attempts: 0}
    {machine, actions} = connect(machine)
    {machine, [:cancel_timer | actions]}
  end

  # The server is gone. The attempt or the connection will notice that itself.
  def handle(machine, {:urls, []}), do: {machine, []}
  def handle(machine, {:urls, urls}), do: {%{machine | urls: urls}, []}

  def handle(%{phase: :connecting} = machine, :connected) do
    {%{machine | phase: :up, failures: %{}}, [{:log, :info, "connected to NATS at #{current(machine)}"}]}
  end

  def handle(%{phase: :connecting} = machine, {:failed, reason}) do
    wait(machine, "cannot connect to NATS at #{current(machine)}: #{reason}")
  end

  def handle(%{phase: :up} = machine, {:closed, reason, up_ms}) do
    machine =
      if up_ms >= machine.stable_ms, do: %{machine | backoff: Backoff.reset(machine.backoff)}, else: machine

    wait(machine, "the connection to NATS at #{current(machine)} is lost: #{reason}")
  end

  def handle(%{phase: :waiting} = machine, :retry), do: connect(machine)

  # A late timer, or a late message of a former connection.
  def handle(machine, _event), do: {machine, []}

  defp connect(machine) do
    machine = %{machine | phase: :connecting, attempts: machine.attempts + 1}
    {machine, [{:connect, current(machine)}]}
  end

  defp current(machine), do: Enum.at(machine.urls, rem(machine.attempts - 1, length(machine.urls)))

  defp wait(machine, reason) do
    url = current(machine)
    # Logged once, not at every attempt.
    log = if reason == machine.failures[url], do: [], else: [{:log, :warning, reason}]
    {delay, backoff} = Backoff.next(machine.backoff)
    failures = machine.failures |> Map.take(machine.urls) |> Map.put(url, reason)
    {%{machine | phase: :waiting, backoff: backoff, failures: failures}, log ++ [{:timer, delay}]}
  end
end
