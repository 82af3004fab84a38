defmodule MavRouter.Link.Serial.Finding do
  @moduledoc """
  What is known about one serial port: its condition, the evidence, and what to do.

  | condition | meaning |
  |---|---|
  | `:vehicle` | MAVLink with a heartbeat: the port to use |
  | `:no_heartbeat` | MAVLink without heartbeats |
  | `:other_protocol` | MSP, CRSF, NMEA, UBX or a console (`protocol`) |
  | `:noise` | bytes that make no sense at any baud rate that was tried |
  | `:silent` | nothing was received |
  | `:no_permission`, `:in_use`, `:absent`, `:not_serial`, `:fault` | it cannot be opened, or was lost |
  """

  alias MavCodec.Sniff

  @enforce_keys [:path, :condition]
  defstruct [:path, :condition, :protocol, :baud, :evidence, :advice]

  # Without advice: nothing has to be ended, the configuration wants it so.
  @other_link {:in_use, "another link"}

  @type condition ::
          :vehicle
          | :no_heartbeat
          | :other_protocol
          | :noise
          | :silent
          | :no_permission
          | :in_use
          | :absent
          | :not_serial
          | :fault

  @typedoc "`evidence` and `advice` are words; `baud` is the rate at which the evidence was heard."
  @type t :: %__MODULE__{
          path: Path.t(),
          condition: condition,
          protocol: Sniff.protocol() | nil,
          baud: pos_integer | nil,
          evidence: String.t() | nil,
          advice: String.t() | nil
        }

  @doc "The finding of listening at a baud rate."
  @spec from_listening(Path.t(), pos_integer, Sniff.t()) :: t
  def from_listening(path, baud, %{protocol: protocol} = sniffed) do
    condition = condition(sniffed)

    %__MODULE__{
      path: path,
      condition: condition,
      protocol: protocol,
      baud: baud,
      evidence: sniffed.evidence,
      advice: advice(condition, protocol, path)
    }
  end

  @doc "Nothing was heard for `seconds`."
  @spec silent(Path.t(), number) :: t
  def silent(path, seconds) do
    %__MODULE__{
      path: path,
      condition: :silent,
      protocol: :silence,
      evidence: "nothing in #{seconds} s",
      advice: advice(:silent, :silence, path)
    }
  end

  @doc "It cannot be opened, or failed; the reasons are those of `Circuits.UART`."
  @spec failed(Path.t(), term) :: t
  def failed(path, reason) do
    condition = refusal(reason)

    %__MODULE__{
      path: path,
      condition: condition,
      evidence: refused(condition, reason),
      advice: if(reason != @other_link, do: advice(condition, nil, path))
    }
  end

  @doc "A port that another link of this gateway has or waits for, and that is therefore not used."
  @spec of_another_link(Path.t()) :: t
  def of_another_link(path),
    do: %__MODULE__{path: path, condition: :in_use, evidence: "belongs to another link"}

  defp condition(%{protocol: protocol, heartbeat: true}) when protocol in [:mavlink1, :mavlink2], do: :vehicle
  defp condition(%{protocol: protocol}) when protocol in [:mavlink1, :mavlink2], do: :no_heartbeat
  defp condition(%{protocol: :noise}), do: :noise
  defp condition(%{protocol: :silence}), do: :silent
  defp condition(_other), do: :other_protocol

  defp refusal(reason) when reason in [:eacces, :eperm], do: :no_permission
  defp refusal(reason) when reason in [:eagain, :ebusy], do: :in_use
  defp refusal(reason) when reason in [:enoent, :enodev, :enxio], do: :absent
  defp refusal({:in_use, _who}), do: :in_use
  defp refusal(:enotty), do: :not_serial
  defp refusal(_other), do: :fault

  defp refused(:no_permission, _reason), do: "no permission to open it"
  defp refused(:in_use, {:in_use, who}), do: "in use by #{who}"
  defp refused(:in_use, _reason), do: "in use by another program or link"
  defp refused(:absent, _reason), do: "does not exist"
  defp refused(:not_serial, _reason), do: "not a serial port"
  defp refused(:fault, reason) when reason in [:eio, :ebadf], do: "unplugged"
  defp refused(:fault, reason) when is_binary(reason), do: reason
  defp refused(:fault, reason) when is_atom(reason), do: to_string(:inet.format_error(reason))
  defp refused(:fault, reason), do: inspect(reason, limit: 10, printable_limit: 200)

  defp advice(:no_heartbeat, _protocol, _path) do
    "a radio whose vehicle is off or out of range? Otherwise let the vehicle send HEARTBEAT on this port"
  end

  defp advice(:other_protocol, protocol, _path) when protocol in [:msp1, :msp2] do
    "this port of Betaflight or iNav speaks MSP: its connection string is msp:auto or msp:DEVICE,BAUD"
  end

  defp advice(:other_protocol, :crsf, _path) do
    "this is the line between radio receiver and flight controller: use a port with MAVLink"
  end

  defp advice(:other_protocol, protocol, _path) when protocol in [:nmea, :ublox] do
    "this is a GPS receiver: connect the flight controller's telemetry port"
  end

  defp advice(:other_protocol, :console, _path) do
    "set the port's protocol to MAVLink (ArduPilot: SERIALn_PROTOCOL 2, PX4: MAV_n_CONFIG), or wait until it has started"
  end

  defp advice(:noise, _protocol, _path) do
    "give the baud rate (DEVICE,BAUD) if it is an unusual one; check ground, voltage level and whether the signal is inverted"
  end

  defp advice(:silent, _protocol, path) do
    if path =~ ~r/betaflight|inav/i,
      do:
        "its name says Betaflight or iNav, whose MSP only answers requests: its connection string is msp:auto or msp:DEVICE,BAUD",
      else: "is it powered, are TX and RX crossed over, and does the port speak MAVLink (SERIALn_PROTOCOL 2)?"
  end

  defp advice(:no_permission, _protocol, _path) do
    "add the user to the group dialout (sudo usermod -aG dialout USER) and sign in again"
  end

  defp advice(:in_use, _protocol, path), do: "end what has it open (sudo fuser -v #{path})"
  defp advice(_condition, _protocol, _path), do: nil

  @doc "One line for people, without the advice."
  @spec format(t) :: String.t()
  def format(%__MODULE__{condition: condition} = finding) do
    "#{finding.path}: #{result_text(condition, finding)}"
  end

  defp result_text(:vehicle, finding), do: heard_words(finding)
  defp result_text(:no_heartbeat, finding), do: heard_words(finding)
  defp result_text(:other_protocol, finding), do: heard_words(finding)
  defp result_text(:noise, finding), do: "at #{finding.baud} baud #{finding.evidence}"
  defp result_text(_condition, finding), do: finding.evidence

  defp heard_words(%{protocol: protocol, baud: baud, evidence: evidence}) do
    "#{Sniff.name(protocol)} at #{baud} baud, #{evidence}"
  end

  @max_listed 4

  @doc "All findings in one line, as the reason of a failed attempt."
  @spec summary([t]) :: String.t()
  def summary([]), do: "no serial port found: plug one in, or name it in the configuration"

  def summary(findings) do
    listed = findings |> Enum.take(@max_listed) |> Enum.map_join("; ", &advised/1)
    more = length(findings) - @max_listed
    "no vehicle heard: #{listed}#{if more > 0, do: "; and #{more} ports more"}"
  end

  defp advised(%{advice: nil} = finding), do: format(finding)
  defp advised(%{advice: advice} = finding), do: "#{format(finding)} (#{advice})"
end
