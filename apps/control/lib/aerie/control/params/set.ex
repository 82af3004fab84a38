defmodule Aerie.Control.Params.Set do
  @moduledoc """
  Sets one parameter, or reads it; a set succeeds only when the vehicle has reported the new value (P3). Events, times and `{:send, _}` are
  those of `Aerie.Control.Params.Fetch.Download`; the end is `{:done, {:ok, param} | {:error, reason}}`.

  If its type is not given, the parameter is read first: PX4 accepts only the parameter's own type, which also decides the encoding. Then it
  is sent until it is answered. Another value may be a late old one, so the set counts as refused only after the vehicle reported another
  value three times.

  An autopilot answers with PARAM_VALUE. A component that speaks PARAM_EXT (the encoding `:extended`, P8) answers with PARAM_EXT_ACK.
  IN_PROGRESS is waited on for as long as the component answers; meanwhile the value is read, because the acknowledgement of the end comes
  once and can be lost. Some components do not acknowledge what they have already, so the value is read with each
  repeated set: one that is shown is set. Acknowledgements do not say whose set they answer, so after each of them the
  value is read: what the component has decides, and the acknowledgement gives the reason.
  """

  alias Aerie.Control.Ftp.RoundTrip
  alias Aerie.Control.Params.{Message, Param}
  alias MavCodec.Enums.ParamAck
  alias MavCodec.Messages, as: M

  @sends 8
  @denials 3
  @silence RoundTrip.silence()
  @progress_us 2_000_000
  @verdicts %{
    ParamAck.value(:PARAM_ACK_ACCEPTED) => :accepted,
    ParamAck.value(:PARAM_ACK_VALUE_UNSUPPORTED) => :unsupported,
    ParamAck.value(:PARAM_ACK_FAILED) => :failed,
    ParamAck.value(:PARAM_ACK_IN_PROGRESS) => :progress
  }

  @enforce_keys [:name, :value, :target, :encoding, :deadline, :trip]
  defstruct [:name, :value, :type, :target, :encoding, :deadline, :trip, :wire, :due, :since, :verdict] ++
              [:shown, sent: 0, denials: 0, phase: :idle]

  @typedoc """
  The phases after `:idle`: `:type` (it is read), `:set` (it is sent), and for PARAM_EXT `:progress` (the component works on it) and `:check` (it is
  read again); `:done`
  """
  @type t :: %__MODULE__{}

  @typedoc """
    * `{:invalid, reason}` - the value does not fit; nothing was sent
    * `{:refused, value | reason}` - the vehicle keeps this value, or says why it refuses the new one or has no such parameter
    * `{:not_set, verdict, {:keeps, value} | :not_shown}` - a component's `:unsupported` and `:failed` are its words; `:accepted` is said of
      a set whose new value the component does not show
    * `:no_answer`, `{:silent, component}`, `:deadline`, `:cancelled` - whether the value was set is unknown if it had been sent. PX4
      1.17 and ArduPilot do not answer for a parameter that they do not have, so no answer may mean that.
  """
  @type reason ::
          {:invalid, String.t()}
          | {:refused, number() | String.t()}
          | {:not_set, :accepted | :unsupported | :failed, {:keeps, Message.value()} | :not_shown}
          | :no_answer
          | {:silent, 0..255}
          | :deadline
          | :cancelled
  @type action :: {:send, [struct(), ...]} | {:done, {:ok, Param.t()} | {:error, reason()}}

  @doc "A set that has not begun. Options: `:type` (MAV_PARAM_TYPE or MAV_PARAM_EXT_TYPE, if known), `:encoding`, `:rtt_us`."
  @spec new(String.t(), Message.value(), Message.target(), deadline :: integer(), keyword()) :: t()
  def new(name, value, target, deadline, options \\ []) do
    %__MODULE__{
      name: name,
      value: value,
      type: options[:type],
      target: target,
      encoding: Keyword.get(options, :encoding, :c_cast),
      deadline: deadline,
      trip: RoundTrip.new(options[:rtt_us])
    }
  end

  @doc "The same machine to read a parameter by its name; its index may have changed (P1)."
  @spec read(String.t(), Message.target(), deadline :: integer(), keyword()) :: t()
  def read(name, target, deadline, options \\ []),
    do: new(name, nil, target, deadline, Keyword.delete(options, :type))

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:idle, :done], do: nil
  def wake_at(set), do: min(set.due, set.deadline)

  @spec handle(t(), Aerie.Control.Params.Fetch.Download.event()) :: {t(), [action()]}
  def handle(%{phase: :done} = set, _event), do: {set, []}
  def handle(set, {:cancel, _now}), do: finish(set, {:error, :cancelled})

  def handle(%{deadline: deadline} = set, {_event, now}) when now >= deadline,
    do: finish(set, {:error, :deadline})

  def handle(%{phase: :idle, type: nil} = set, {:start, now}), do: enter(set, :type, now)
  def handle(%{phase: :idle} = set, {:start, now}), do: begin(set, now)
  def handle(%{phase: :idle} = set, _early), do: {set, []}
  def handle(%{due: due} = set, {:tick, now}) when now >= due, do: late(set, now)

  def handle(
        %{target: from, name: name, encoding: :extended} = set,
        {:message, %M.ParamExtAck{param_id: name} = ack, from, now}
      ),
      do: acknowledged(set, Map.get(@verdicts, ack.param_result, :failed), now)

  def handle(%{target: from} = set, {:message, message, from, now}) do
    case Message.about(message, set.name, set.encoding) do
      {:value, param} -> reported(set, param, now)
      {:refused, reason} -> finish(set, {:error, {:refused, reason}})
      :other -> {set, []}
    end
  end

  def handle(set, _other), do: {set, []}

  # The component works on it: a repeated set would be another one.
  defp acknowledged(%{phase: phase} = set, :progress, now) when phase in [:set, :progress],
    do: {%{set | phase: :progress, sent: 0, due: now + @progress_us}, []}

  defp acknowledged(%{phase: phase} = set, verdict, now) when phase in [:set, :progress],
    do: enter(%{set | verdict: verdict}, :check, now)

  # The answer to a repeated set, or to another client's.
  defp acknowledged(set, _verdict, _now), do: {set, []}

  defp reported(%{phase: :type, value: nil} = read, param, _now), do: finish(read, {:ok, param})
  defp reported(%{phase: :type} = set, param, now), do: begin(%{set | type: param.type}, now)

  defp reported(set, param, now) do
    cond do
      Message.same?(param.value, set.wire, set.type, set.encoding) -> finish(set, {:ok, param})
      # It may have been on its way when the value was sent.
      set.phase == :set and set.encoding == :extended -> {set, []}
      set.phase == :progress -> {%{set | sent: 0, due: now + @progress_us}, []}
      set.phase == :set -> {%{set | shown: param.value || "it keeps a value that is not a number"}, []}
      set.verdict == :accepted -> {%{set | shown: {:keeps, param.value}}, []}
      true -> refused(set, {:keeps, param.value})
    end
  end

  # Another value can be an old one that comes late, so it has to be shown several times.
  defp late(%{shown: shown, denials: denials} = set, _now) when shown != nil and denials + 1 == @denials,
    do: refused(set, shown)

  defp late(%{shown: shown} = set, now) when shown != nil,
    do: enter(%{set | shown: nil, denials: set.denials + 1}, set.phase, now)

  defp late(%{sent: sent, since: since} = set, now) when sent >= @sends and now - since >= @silence do
    if set.phase == :check,
      do: refused(set, :not_shown),
      else: finish(set, {:error, Message.silence(set.target, set.encoding)})
  end

  defp late(set, now), do: again(set, now)

  defp begin(set, now) do
    case Message.encode(set.value, set.type, set.encoding) do
      {:ok, wire} -> enter(%{set | wire: wire}, :set, now)
      {:error, reason} -> finish(set, {:error, {:invalid, reason}})
    end
  end

  defp enter(set, phase, now), do: again(%{set | phase: phase, sent: 0}, now)

  defp again(set, now) do
    read = Message.read(set.target, set.name, set.encoding)

    messages =
      if set.phase == :set,
        do: [Message.set(set.target, set.name, set.wire, set.type, set.encoding)],
        else: [read]

    shown? = set.phase == :set and set.encoding == :extended and set.sent > 0
    messages = if shown?, do: messages ++ [read], else: messages

    since = if set.sent == 0, do: now, else: set.since
    due = now + RoundTrip.timeout(set.trip, set.sent)
    {%{set | sent: set.sent + 1, since: since, due: due}, [{:send, messages}]}
  end

  defp refused(%{phase: :check} = set, shown), do: finish(set, {:error, {:not_set, set.verdict, shown}})
  defp refused(set, value), do: finish(set, {:error, {:refused, value}})
  defp finish(set, result), do: {%{set | phase: :done}, [{:done, result}]}
end
