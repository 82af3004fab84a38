defmodule Aerie.Params.Set do
  @moduledoc """
  Sets one parameter; this succeeds only when the vehicle has reported the new value (P3). Events, times and `{:send, _}` are those
  of `Aerie.Params.Download`; the end is `{:done, {:ok, param} | {:error, reason}}`.

  If its type is not given, the parameter is read first: PX4 accepts only the parameter's own type, which also decides the encoding. Then it
  is sent until a PARAM_VALUE has the value. Another value may be a late old one, so the set counts as refused only
  after it was sent three times and the vehicle reported another value each time.
  """

  alias Aerie.Ftp.RoundTrip
  alias Aerie.Params.{Message, Param}
  alias Aerie.Protocol.ParamValue

  @sends 8
  @denials 3
  @silence RoundTrip.silence()

  @enforce_keys [:name, :value, :target, :encoding, :deadline, :trip]
  defstruct [
    :name,
    :value,
    :type,
    :target,
    :encoding,
    :deadline,
    :trip,
    :wire,
    :due,
    :since,
    :shown,
    sent: 0,
    denials: 0,
    phase: :idle
  ]

  @type t :: %__MODULE__{}

  @typedoc """
    * `{:invalid, reason}` - the value does not fit; nothing was sent
    * `{:refused, value | reason}` - the vehicle keeps this value, or says why it refuses the new one
    * `:no_answer`, `:deadline`, `:cancelled` - whether the value was set is unknown if it had been sent (`sent?/1`)
  """
  @type reason ::
          {:invalid, String.t()}
          | {:refused, number() | String.t()}
          | :no_answer
          | :deadline
          | :cancelled
  @type action :: {:send, [struct(), ...]} | {:done, {:ok, Param.t()} | {:error, reason()}}

  @doc """
  A set that has not begun. Options: `:type` (MAV_PARAM_TYPE, if known), `:encoding`, `:rtt_us`. Without a value
  the parameter is only read (`Aerie.Params.Get`).
  """
  @spec new(String.t(), number() | nil, Message.target(), deadline :: integer(), keyword()) :: t()
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

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:idle, :done], do: nil
  def wake_at(set), do: min(set.due, set.deadline)

  @doc "Whether a PARAM_SET was sent."
  @spec sent?(t()) :: boolean()
  def sent?(set), do: set.wire != nil

  @spec handle(t(), Aerie.Params.Download.event()) :: {t(), [action()]}
  def handle(%{phase: :done} = set, _event), do: {set, []}
  def handle(set, {:cancel, _now}), do: finish(set, {:error, :cancelled})

  def handle(%{deadline: deadline} = set, {_event, now}) when now >= deadline,
    do: finish(set, {:error, :deadline})

  def handle(%{phase: :idle, type: nil} = set, {:start, now}), do: again(%{set | phase: :type}, now)
  def handle(%{phase: :idle} = set, {:start, now}), do: begin(set, now)

  def handle(%{phase: phase, due: due} = set, {:tick, now}) when phase != :idle and now >= due,
    do: late(set, now)

  def handle(%{phase: phase, target: from} = set, {:message, message, from, now}) when phase != :idle do
    case Message.about(message, set.name, set.encoding) do
      {:value, param} -> shown(set, param, now)
      {:refused, reason} -> finish(set, {:error, {:refused, reason}})
      :other -> {set, []}
    end
  end

  def handle(set, _other), do: {set, []}

  defp shown(%{phase: :type, value: nil} = get, param, _now), do: finish(get, {:ok, param})
  defp shown(%{phase: :type} = set, param, now), do: begin(%{set | type: param.type}, now)

  defp shown(set, param, _now) do
    if ParamValue.same?(param.value, sent_value(set)),
      do: finish(set, {:ok, param}),
      else: {%{set | shown: param.value || "it keeps a value that is not a number"}, []}
  end

  defp late(%{shown: nil, sent: sent, since: since} = set, now)
       when sent >= @sends and now - since >= @silence,
       do: finish(set, {:error, Message.silence(set.target, set.encoding)})

  defp late(%{shown: nil} = set, now), do: again(set, now)

  defp late(%{denials: denials} = set, _now) when denials + 1 == @denials,
    do: finish(set, {:error, {:refused, set.shown}})

  defp late(set, now), do: again(%{set | shown: nil, sent: 0, denials: set.denials + 1}, now)

  # The vehicle reports a float as the nearest one of 32 bits.
  defp sent_value(%{value: value, type: type}), do: if(ParamValue.range(type), do: trunc(value), else: value)

  defp begin(set, now) do
    case ParamValue.encode(set.value, set.type, set.encoding) do
      {:ok, wire} -> again(%{set | phase: :set, wire: wire, sent: 0}, now)
      {:error, reason} -> finish(set, {:error, {:invalid, reason}})
    end
  end

  defp again(set, now) do
    message =
      if set.phase == :set,
        do: Message.set(set.target, set.name, set.wire, set.type, set.encoding),
        else: Message.read(set.target, set.name, set.encoding)

    since = if set.sent == 0, do: now, else: set.since
    due = now + RoundTrip.timeout(set.trip, set.sent)
    {%{set | sent: set.sent + 1, since: since, due: due}, [{:send, [message]}]}
  end

  defp finish(set, result), do: {%{set | phase: :done}, [{:done, result}]}
end
