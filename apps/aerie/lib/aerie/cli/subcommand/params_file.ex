defmodule Aerie.CLI.Subcommand.ParamsFile do
  @moduledoc "`aerie params save`: the gateway reads the parameters; this program writes the file with its user's rights."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.{Gateway, Subcommand}

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"VEHICLE" => vehicle, "FILE" => file}, folder: folder} = request) do
    path = Path.expand(file, folder)
    format = Map.get(%{".params" => :params, ".txt" => :txt}, Path.extname(path), :param)

    with {:ok, node, _entry} <- Gateway.connect(request),
         {:ok, text} <- Gateway.call(node, Subcommand.Params, :file, [vehicle, format]),
         {:file, :ok} <- {:file, File.write(path, text)} do
      {0, "wrote #{path}\n"}
    else
      {:file, {:error, posix}} -> {:error, "#{path}: #{:file.format_error(posix)}"}
      other -> other
    end
  end
end
