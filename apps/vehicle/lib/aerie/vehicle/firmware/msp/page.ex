defmodule Aerie.Vehicle.Firmware.Msp.Page do
  @moduledoc "The table of `docs/msp.md`: how much of MSP is known of each firmware and version."

  alias Aerie.Vehicle.Command.Page
  alias MavCodec.Msp.{Message, Messages, Params}

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
      "versions" => Page.table(header, rows(:betaflight, "Betaflight") ++ rows(:inav, "iNav"))
    }
  end

  defp rows(firmware, name) do
    for {_numbers, version, release} <- Params.releases(firmware) do
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
