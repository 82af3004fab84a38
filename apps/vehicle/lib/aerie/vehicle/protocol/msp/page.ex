defmodule Aerie.Vehicle.Protocol.Msp.Page do
  @moduledoc "The table of `docs/msp.md`: how much of MSP is known of each firmware and version."

  alias Aerie.Vehicle.Command.Page
  alias MavCodec.Msp.{Message, Messages, Params}

  # By the version that gates messages: the API's of Betaflight, the firmware's of iNav.
  @betaflight [
    {{1, 40}, "3.5"},
    {{1, 41}, "4.0"},
    {{1, 42}, "4.1"},
    {{1, 43}, "4.2"},
    {{1, 44}, "4.3"},
    {{1, 45}, "4.4"},
    {{1, 46}, "4.5"},
    {{1, 47}, "2025.12"},
    {{1, 48}, "2026.6"},
    {{1, 49}, "2026.12"}
  ]
  @inav for version <- [{7, 0}, {7, 1}, {8, 0}, {9, 0}, {9, 1}],
            {major, minor} = version,
            do: {version, "#{major}.#{minor}"}

  @doc "The section by its name."
  @spec sections() :: %{String.t() => String.t()}
  def sections do
    header = [
      "firmware",
      "API",
      "messages that read",
      "that write",
      "parameters",
      "missions",
      "overridden channels stop with MSP"
    ]

    %{
      "versions" =>
        Page.table(header, rows(:betaflight, "Betaflight", @betaflight) ++ rows(:inav, "iNav", @inav))
    }
  end

  defp rows(firmware, name, versions) do
    for {version, release} <- versions do
      known =
        for message <- Messages.all(firmware),
            Message.in?(message, version),
            message.never == nil,
            do: message.kind

      [
        "#{name} #{release}",
        if(firmware == :betaflight, do: "#{elem(version, 0)}.#{elem(version, 1)}", else: "2.5"),
        "#{Enum.count(known, &(&1 == :read))}",
        "#{Enum.count(known, &(&1 == :write))}",
        if(firmware == :betaflight,
          do: "#{length(Params.all(firmware, version))}",
          else: "as the vehicle lists them"
        ),
        if(firmware == :inav, do: "yes", else: "no"),
        if(Msp.Receiver.hands_back?({firmware, version}), do: "yes", else: "no: refused")
      ]
    end
  end
end
