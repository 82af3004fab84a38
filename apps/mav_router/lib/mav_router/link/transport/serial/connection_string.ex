defmodule MavRouter.Link.Transport.Serial.ConnectionString do
  @moduledoc """
  The connection strings of serial ports.

  | string | meaning |
  |---|---|
  | `DEVICE`, `DEVICE,BAUD` | that port, by default at 115,200 baud |
  | `serial:DEVICE` | that port, whose baud rate is found by listening |
  | `serial:auto` | the first port with a vehicle behind it (`MavRouter.Link.Serial.Detector`) |

  Those with `serial:` take `bauds=57600,921600` (candidates instead of the usual ones); `serial:auto` also takes
  `ports=/dev/ttyAMA0,/dev/ttyUSB3` (listened to first) and `only=true` (no other ports).
  """

  alias MavRouter.Link.Transport.Form
  alias MavRouter.Link.Transport.Query

  @rates 50..20_000_000
  @max_candidates 20

  @doc "See `c:MavRouter.Link.Transport.forms/0`."
  @spec forms() :: [Form.t()]
  def forms do
    [
      %Form{
        prefix: "serial:",
        expected: "serial:auto, serial:DEVICE or DEVICE,BAUD",
        example: "serial:auto",
        help: [
          {"serial:auto", "find the serial port and baud rate of a vehicle"},
          {"serial:DEVICE", "a serial port whose baud rate is found"}
        ],
        options: ["bauds", "ports", "only"]
      },
      %Form{
        prefix: "",
        expected: "DEVICE or DEVICE,BAUD",
        example: "/dev/ttyACM0,115200",
        help: [{"DEVICE,BAUD", "a serial port, e.g. /dev/ttyACM0,57600"}]
      }
    ]
  end

  @doc "See `c:MavRouter.Link.Transport.parse/2`."
  @spec parse(String.t(), String.t()) :: {:ok, map} | {:error, String.t() | :unknown}
  def parse("serial:", "auto"), do: {:ok, %{detect: :port}}

  def parse("serial:", text) do
    case parse("", text) do
      {:ok, %{baud: _given} = fields} -> {:ok, fields}
      {:ok, fields} -> {:ok, Map.put(fields, :detect, :baud)}
      {:error, :unknown} -> {:error, "#{inspect(text)} is not a serial device"}
      {:error, words} -> {:error, words}
    end
  end

  def parse("", text) do
    case String.split(text, ",") do
      [device | rates] when length(rates) <= 1 ->
        if device?(device), do: port(device, rates), else: {:error, :unknown}

      _more ->
        {:error, "there are too many commas"}
    end
  end

  defp port(device, []), do: {:ok, %{device: device}}

  defp port(device, [text]) do
    case rate(text) do
      {:ok, rate} -> {:ok, %{device: device, baud: rate}}
      :error -> {:error, "#{inspect(text)} is not a valid baud rate"}
    end
  end

  defp rate(text) do
    case Integer.parse(text) do
      {rate, ""} when rate in @rates -> {:ok, rate}
      _other -> :error
    end
  end

  defp device?("/" <> rest), do: rest != ""
  defp device?(name), do: name =~ ~r/\A(tty|cu\.|rfcomm|COM)[\w.-]+\z/

  @doc "See `c:MavRouter.Link.Transport.option/3`."
  @spec option(String.t(), String.t(), String.t()) :: {:ok, atom, term} | {:error, Query.reasons()}
  def option(_prefix, "only", value), do: Query.boolean(:only, value)

  def option(_prefix, "bauds", value) do
    rates = value |> String.split(",") |> Enum.map(&rate/1)

    if length(rates) <= @max_candidates and :error not in rates,
      do: {:ok, :bauds, Enum.map(rates, &elem(&1, 1))},
      else:
        {:error,
         reason: "#{inspect(value)} is not a list of baud rates",
         expected: "up to #{@max_candidates} rates with commas between them",
         example: "serial:auto?bauds=57600,921600"}
  end

  def option(_prefix, "ports", value) do
    ports = String.split(value, ",")

    if length(ports) <= @max_candidates and Enum.all?(ports, &device?/1),
      do: {:ok, :ports, ports},
      else:
        {:error,
         reason: "#{inspect(value)} is not a list of serial ports",
         expected: "up to #{@max_candidates} ports with commas between them",
         example: "serial:auto?ports=/dev/ttyAMA0,/dev/ttyUSB0"}
  end
end
