defmodule Msp.Identity do
  @moduledoc """
  What answers at an MSP port: what API_VERSION, FC_VARIANT and FC_VERSION say, and whether that is a vehicle.

  | answer | is |
  |---|---|
  | BTFL, API 1.40 to 1.49 | Betaflight; versions of messages are those of the API |
  | INAV, API 2, firmware 7 to 9 | iNav; versions of messages are those of the firmware |
  | INAV, API 1 | iNav's port for a DJI video unit: a few messages, some of them made up |
  | ARDU | ArduPilot, whose MSP is for displays and answers what it does not know with success |
  | anything else | named, and left alone |
  """

  alias MavCodec.Msp.Guard
  alias Msp.Firmware

  @longest 31
  @others %{
    "CLFL" => "Cleanflight",
    "BAFL" => "Baseflight",
    "RTFL" => "Rotorflight, whose messages have other meanings",
    "ARDU" => "ArduPilot, whose MSP is for displays: use its MAVLink",
    "EMUF" => "EmuFlight",
    "QUIC" => "Quicksilver"
  }

  @enforce_keys [:firmware, :version, :text]
  defstruct [:firmware, :version, :text, :api, :release, :uid, :name]

  @typedoc """
  - `version`: by which messages are read (`t:MavCodec.Msp.Guard.target/0`)
  - `text`: for people, as "Betaflight 4.5.5 (API 1.46)"
  - `uid`: of the processor, the same after a restart; simulators all have the same one
  """
  @type t :: %__MODULE__{
          firmware: MavCodec.Msp.Messages.firmware(),
          version: {non_neg_integer, non_neg_integer},
          text: String.t(),
          api: {non_neg_integer, non_neg_integer},
          release: {non_neg_integer, non_neg_integer, non_neg_integer},
          uid: String.t() | nil,
          name: String.t() | nil
        }

  @doc """
  The vehicle that gave these answers, or why they are not a vehicle's.

      iex> {:ok, identity} = Msp.Identity.of({1, 46}, "BTFL", %{major_or_year: 4, minor_or_month: 5, patch: 5})
      iex> {identity.version, identity.text}
      {{1, 46}, "Betaflight 4.5.5 (API 1.46)"}
      iex> Msp.Identity.of({1, 42}, "INAV", %{major_or_year: 4, minor_or_month: 1, patch: 0})
      {:error, "iNav's port for a video unit, which cannot be controlled: use another port of the vehicle"}
  """
  @spec of({non_neg_integer, non_neg_integer}, binary, map) :: {:ok, t} | {:error, String.t()}
  def of({major, minor} = api, variant, version) do
    case Enum.find(Firmware.modules(), &(&1.facts().variant == variant)) do
      nil ->
        name = Map.get(@others, variant, "a firmware that calls itself #{inspect(printable(variant))}")
        {:error, "#{name} (MSP API #{major}.#{minor}): not a vehicle that Aerie can use over MSP"}

      firmware ->
        numbers = numbers(version)

        with {:ok, read_by, text} <- firmware.identify(api, release(version), numbers) do
          name = firmware.facts().name
          {:ok, %__MODULE__{firmware: name, version: read_by, text: text, api: api, release: numbers}}
        end
    end
  end

  @doc "The firmware and version by which its messages are read."
  @spec target(t) :: Guard.target()
  def target(%__MODULE__{firmware: firmware, version: version}), do: {firmware, version}

  defp numbers(version),
    do: {version[:major_or_year] || 0, version[:minor_or_month] || 0, version[:patch] || 0}

  @doc "Text from a flight controller, as far as it can be shown: it may be anything."
  @spec printable(binary) :: String.t()
  def printable(text),
    do: for(<<byte <- binary_slice(text, 0, @longest)>>, byte in 32..126, into: "", do: <<byte>>)

  defp release(%{text: text}) when is_binary(text) and text != "", do: printable(text)
  defp release(version), do: version |> numbers() |> Tuple.to_list() |> Enum.join(".")
end
