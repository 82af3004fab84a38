defmodule Mix.Tasks.Mav.Import do
  @shortdoc "Imports MAVLink XML definitions"

  @moduledoc """
  Imports MAVLink definitions: reads XML, checks it, and writes the facts that the codec is compiled from.

      mix mav.import FILE.xml [FILE.xml ...] [--source NAME] [--out DIR] [--base SOURCE|DIR]

  Included files are imported too. Each XML file gives one facts file; importing again gives the same bytes.
  A file with an error is reported as `file:line: reason`, and nothing is written.

    * `--source NAME` - folder under `priv/definitions` (default: the first file's name without `.xml`)
    * `--out DIR` - folder to write to, instead of `priv/definitions/NAME`
    * `--base SOURCE` - where to search for included files that are not beside the file: an imported source
      (`upstream`, `ardupilot`) or a folder of facts files

  The README in `priv/definitions` explains how a new dialect is compiled.
  """

  use Mix.Task

  alias MavCodec.Definition.Importer

  @switches [source: :string, out: :string, base: :string]

  @impl Mix.Task
  def run(args) do
    {options, paths} = parse(args)
    source = options[:source] || paths |> hd() |> Path.basename(".xml")

    if not (source =~ ~r/\A[A-Za-z][A-Za-z0-9_]*\z/),
      do: Mix.raise("mav.import: --source #{inspect(source)}: expected letters, digits and _")

    out = options[:out] || Path.join(definitions(), source)

    case Importer.import(paths, base(options[:base])) do
      {:ok, files} ->
        File.mkdir_p!(out)
        Enum.each(files, fn {name, facts} -> File.write!(Path.join(out, name), facts) end)
        Mix.shell().info("#{length(files)} definition files in #{Path.relative_to_cwd(out)}")

      {:error, error} ->
        Mix.raise(Exception.message(error))
    end
  end

  defp parse(args) do
    case OptionParser.parse(args, strict: @switches) do
      {_options, [], []} ->
        Mix.raise("mav.import: no file given (mix help mav.import)")

      {options, paths, []} ->
        {options, paths}

      {_options, _paths, [{option, _} | _]} ->
        Mix.raise("mav.import: unknown option #{option} (mix help mav.import)")
    end
  end

  defp base(nil), do: nil
  defp base(base), do: if(File.dir?(base), do: base, else: Path.join(definitions(), base))

  # The source tree's priv, not the build's.
  defp definitions do
    app = if Mix.Project.umbrella?(), do: "apps/mav_codec", else: "."
    Path.join([app, "priv", "definitions"])
  end
end
