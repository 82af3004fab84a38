defmodule Aerie.Params.Get do
  @moduledoc """
  Reads one parameter by its name; its index may have changed (P1). This is what `Aerie.Params.Set` begins with. Events, times and
  `{:send, _}` are those of `Aerie.Params.Download`; the end is `{:done, {:ok, param} | {:error, reason}}`.

  PX4 1.17 and ArduPilot do not answer for a parameter that they do not have, so `:no_answer` may mean that. With the encoding
  `:extended` another component is asked (PARAM_EXT, P8), for which the same reason is `{:silent, component}`.
  """

  alias Aerie.Params.{Message, Param, Set}

  @type t :: Set.t()
  @type reason :: :no_answer | {:silent, 0..255} | {:refused, String.t()} | :deadline | :cancelled
  @type action :: {:send, [struct(), ...]} | {:done, {:ok, Param.t()} | {:error, reason()}}

  @doc "A read that has not begun. Options: `:encoding`, `:rtt_us`."
  @spec new(String.t(), Message.target(), deadline :: integer(), keyword()) :: t()
  def new(name, target, deadline, options \\ []),
    do: Set.new(name, nil, target, deadline, Keyword.delete(options, :type))

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  defdelegate wake_at(get), to: Set

  @spec handle(t(), Aerie.Params.Download.event()) :: {t(), [action()]}
  defdelegate handle(get, event), to: Set
end
