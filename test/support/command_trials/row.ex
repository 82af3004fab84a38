defmodule Aerie.CommandTrials.Row do
  @moduledoc "One command of `Aerie.CommandTrials`."

  alias MavCodec.Enums.{MavCmd, MavResult}

  defstruct [
    :type,
    :params,
    :raw,
    :own,
    :ack,
    :mavsdk,
    :mavsdk_hears,
    :does,
    :hears,
    lasts_s: 0,
    result: "SUCCESS"
  ]

  @typedoc """
    * `params`, `own` - the command as Aerie takes it, and the status of its result
    * `raw`, `ack` - the message that pymavlink sends (`test/peers/pymavlink_commands.py`), and the result of its COMMAND_ACK; nil: no such
      answer
    * `mavsdk`, `result` - MAVSDK's methods with their arguments, and the last one's result; `{:no, reason}` if it has none
    * `hears` - what the vehicle must have heard: a command or a message; nil: nothing reaches it
    * `mavsdk_hears` - what MAVSDK sends in place of that
    * `does` - what the vehicle must then show, where it was not refused
    * `lasts_s` - seconds of the vehicle's time before the next row
  """
  @type t :: %__MODULE__{}

  @doc "A row; `more` are further fields."
  @spec row(String.t(), map(), map(), atom(), 0..9 | nil, keyword()) :: t()
  def row(type, params, raw, own, ack, more) do
    row = %__MODULE__{type: type, params: params, raw: raw, own: own, ack: ack, hears: heard(raw)}
    struct!(row, more)
  end

  @doc "Degrees as MAVLink's integers have them."
  @spec e7(float()) :: integer()
  def e7(degrees), do: round(degrees * 1.0e7)

  @doc "COMMAND_LONG; nil is NaN."
  @spec long(String.t(), [number() | nil]) :: map()
  def long(name, params), do: %{"long" => [command(name) | params]}

  @doc "COMMAND_INT."
  @spec int(String.t(), non_neg_integer(), [number() | nil], {integer(), integer()}, number() | nil) :: map()
  def int(name, frame, params, {x, y}, z), do: %{"int" => [command(name), frame] ++ params ++ [x, y, z]}

  @doc "Another message, once."
  @spec message(String.t(), map()) :: map()
  def message(name, fields), do: %{"send" => name, "fields" => fields}

  @doc "Another message, until the next one."
  @spec stream(String.t(), map()) :: map()
  def stream(name, fields), do: name |> message(fields) |> Map.put("stream", true)

  @doc "Its method of MAVSDK, or why there is none."
  @spec method(t()) :: String.t()
  def method(%{mavsdk: {:no, reason}}), do: reason

  def method(row) do
    case row.mavsdk |> List.wrap() |> List.last() do
      {name, _arguments} -> "`#{name}`"
      name -> "`#{name}`"
    end
  end

  @doc "What a row says of MAVSDK's result, and of the acknowledgement that pymavlink gets."
  @spec result(t()) :: String.t()
  def result(%{mavsdk: {:no, _reason}}), do: ""
  def result(row), do: row.result

  @spec acknowledgement(t()) :: String.t()
  def acknowledgement(%{ack: nil}), do: "no answer"
  def acknowledgement(%{ack: ack}), do: MavResult.label(ack)

  defp command(name), do: MavCmd.value(:"MAV_CMD_#{name}") || raise(ArgumentError, "no command #{name}")

  defp heard(%{"long" => [command | _params]}), do: command
  defp heard(%{"int" => [command | _params]}), do: command
  defp heard(%{"send" => name}), do: name
end
