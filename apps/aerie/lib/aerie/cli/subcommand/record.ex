defmodule Aerie.CLI.Subcommand.Record do
  @moduledoc "`aerie record` (`MavRouter.Recorder`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Json
  alias MavRouter.Recorder
  alias Aerie.CLI.Output.Columns

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"ACTION" => "list"}, options: options}) do
    files = Recorder.list(:default)

    if options[:json],
      do: {0, [Json.encode_to_iodata!(Json.plain(files)), ?\n]},
      else:
        {0, Columns.render(~w(FILE BYTES OPEN), for(file <- files, do: [file.file, file.bytes, file.open]))}
  end

  def run(%{arguments: %{"ACTION" => action, "VEHICLE" => vehicle}}) do
    case action do
      "start" -> done(Recorder.start(:default, {:vehicle, vehicle}), "recording #{vehicle}")
      "stop" -> done(Recorder.stop(:default, {:vehicle, vehicle}), "no longer recording #{vehicle}")
      "save" -> saved(Recorder.save(:default, vehicle, "request"))
      other -> {:error, "'#{other}': expected start, stop, save or list"}
    end
  end

  def run(_request), do: {:error, "record start, stop and save need a VEHICLE"}

  defp saved({:ok, file}), do: {0, "#{file}\n"}
  defp saved({:error, error}), do: {:error, Exception.message(error)}

  defp done(:ok, text), do: {0, text <> "\n"}
  defp done({:error, error}, _text), do: {:error, Exception.message(error)}
end
