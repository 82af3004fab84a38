defmodule Msp.Test.Controller do
  @moduledoc "A flight controller of few words, for `Msp.Test.Line`: answers by message name, refuses what it has no answer for."

  alias MavCodec.Msp.{Frame, Messages, Parser, Payload}

  @doc "Answers of Betaflight 4.5.5 to what the session asks; others on top of them. A value nil is silence."
  def betaflight(more \\ %{}) do
    answers(
      {:betaflight, {1, 46}},
      Map.merge(
        %{
          "API_VERSION" => %{protocol: 0, api_major: 1, api_minor: 46},
          "FC_VARIANT" => %{variant: "BTFL"},
          "FC_VERSION" => %{major_or_year: 4, minor_or_month: 5, patch: 5},
          "UID" => %{id0: 1, id1: 2, id2: 3},
          "NAME" => %{name: "racer"},
          "BOXIDS" => %{entries: [%{id: 0}, %{id: 1}, %{id: 27}]},
          "MIXER_CONFIG" => %{mixer: 3, yaw_motors_reversed: 0},
          "STATUS_EX" => status(%{}),
          "ATTITUDE" => %{roll: 123, pitch: -45, yaw: 270},
          "ALTITUDE" => %{altitude: 250, vario: -30}
        },
        more
      )
    )
  end

  @doc "The same of iNav 9.0.0."
  def inav(more \\ %{}) do
    answers(
      {:inav, {9, 0}},
      Map.merge(
        %{
          "API_VERSION" => %{protocol: 0, api_major: 2, api_minor: 5},
          "FC_VARIANT" => %{variant: "INAV"},
          "FC_VERSION" => %{major: 9, minor: 0, patch: 0},
          "BOXIDS" => %{entries: [%{id: 0}, %{id: 28}]},
          "MSP2_INAV_STATUS" => %{
            cycle_time: 500,
            i2c_errors: 0,
            sensors: 1,
            cpu_load: 3,
            profiles: 0,
            arming_flags: 0,
            mode_flags: 0,
            mixer_profile: 0
          }
        },
        more
      )
    )
  end

  @doc "The answer to STATUS_EX with other values."
  def status(more) do
    Map.merge(
      %{
        cycle_time: 125,
        i2c_errors: 0,
        sensors: 0b100011,
        mode_flags: 0,
        pid_profile: 0,
        cpu_load: 12,
        pid_profiles: 4,
        rate_profile: 0,
        more_flags: [],
        arming_disable_count: 26,
        arming_disable_flags: 0,
        config_state: 0,
        cpu_temperature: 40
      },
      more
    )
  end

  @doc "Answers of a firmware: a map of values by message, or a function of it and the time in us."
  def answers({firmware, version}, all) do
    fn bytes, us ->
      {[request], _parser} = Parser.push(Parser.new(), bytes)
      {:ok, message} = Messages.fetch(firmware, request.id)
      values = if is_function(all), do: all.(message.name, us), else: Map.get(all, message.name, :refused)
      values = if is_function(values), do: values.(us), else: values

      case values do
        nil -> nil
        raw when is_binary(raw) -> raw
        :refused -> Frame.encode(%{request | direction: :error, payload: ""})
        :done -> Frame.encode(%{request | direction: :reply, payload: ""})
        values -> Frame.encode(%{request | direction: :reply, payload: payload(message, values, version)})
      end
    end
  end

  defp payload(message, values, version) do
    {:ok, payload} = Payload.encode(message.reply, values, version)
    payload
  end
end
