defmodule Msp.Session.Requests do
  @moduledoc """
  Messages that a vehicle sends once or on request: who it is, its modes, intervals. Answered here, without the flight controller.
  """

  alias MavCodec.Messages, as: M
  alias Msp.{Firmware, Modes, Polls, Session}

  @custom_version 8

  @doc "The message that REQUEST_MESSAGE asks for, and its parameter 2; `:error` for one that is not made on request."
  @spec message(Session.t(), id :: non_neg_integer, index :: non_neg_integer) :: {:ok, [struct]} | :error
  def message(session, id, index) do
    cond do
      id == M.AutopilotVersion.id() -> {:ok, [version(session)]}
      id == M.ComponentInformationBasic.id() -> {:ok, [identity(session)]}
      id == M.AvailableModes.id() and index == 0 -> {:ok, modes(session)}
      id == M.AvailableModes.id() -> mode(session, index)
      true -> :error
    end
  end

  defp mode(session, index) do
    case Enum.fetch(modes(session), index - 1) do
      {:ok, mode} -> {:ok, [mode]}
      :error -> :error
    end
  end

  @doc "COMPONENT_INFORMATION_BASIC: which firmware it is, in words. Nothing else in MAVLink says so of these."
  @spec identity(Session.t()) :: struct
  def identity(%{identity: identity}) do
    %M.ComponentInformationBasic{
      vendor_name: Firmware.of(identity.firmware).title,
      model_name: fit(identity.name || "", 31),
      software_version: fit(identity.text, 23),
      serial_number: fit(identity.uid || "", 31)
    }
  end

  @doc "AUTOPILOT_VERSION."
  @spec version(Session.t()) :: struct
  def version(%{identity: identity}) do
    {major, minor, patch} = identity.release

    %M.AutopilotVersion{
      capabilities: Firmware.of(identity.firmware).capabilities,
      flight_sw_version: :binary.decode_unsigned(<<rem(major, 256), rem(minor, 256), rem(patch, 256), 255>>),
      flight_custom_version: :binary.copy(<<0>>, @custom_version),
      middleware_custom_version: :binary.copy(<<0>>, @custom_version),
      os_custom_version: :binary.copy(<<0>>, @custom_version),
      uid2: uid(identity.uid)
    }
  end

  defp uid(nil), do: :binary.copy(<<0>>, 18)
  defp uid(hex), do: Base.decode16!(hex, case: :lower) <> :binary.copy(<<0>>, 18 - div(byte_size(hex), 2))

  @doc "AVAILABLE_MODES of all modes, by which any client knows their names."
  @spec modes(Session.t()) :: [struct]
  def modes(%{identity: %{firmware: firmware}}) do
    all = Modes.all(firmware)

    for {{number, name}, index} <- Enum.with_index(all, 1) do
      %M.AvailableModes{
        number_modes: length(all),
        mode_index: index,
        standard_mode: Modes.standard(firmware, number),
        custom_mode: number,
        # Only the switches of the pilot select it.
        properties: 2,
        mode_name: name
      }
    end
  end

  @doc "MESSAGE_INTERVAL of a message."
  @spec interval(Session.t(), non_neg_integer) :: struct
  def interval(session, id),
    do: %M.MessageInterval{message_id: id, interval_us: Polls.interval(session.polls, id) || 0}

  defp fit(text, bytes), do: binary_slice(text, 0, bytes)
end
