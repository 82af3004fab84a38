# What the sources and the compiled code say: the files and modules of each app, which file uses which, which modules
# a file names.
defmodule Layers.Source do
  @root Path.expand("../../../..", __DIR__)
  # Modules that are made from the MAVLink definitions: some eight hundred, of which each group counts as one.
  @generated ~w(MavCodec.Messages. MavCodec.Enums. MavCodec.Dialects.)

  @doc """
  Each of `apps` (`{name, prefixes of its modules}`, from the bottom up) as a map: `:files` and `:edges` as paths below
  lib/ without .ex, `:main` the folder of its parts, `:uses` the other apps, `:modules`, and `:names` with the modules
  of other files that each file names, as `{app, module}`. The caller has compiled the code.
  """
  def read(apps) do
    owners =
      for {app, _prefixes} <- apps, file <- files(app), reduce: %{}, do: (owners -> owned(owners, file, app))

    modules = Map.new(apps, fn {app, _prefixes} -> {app, modules(app)} end)
    known = for {app, modules} <- modules, {module, file} <- modules, into: %{}, do: {module, {app, file}}
    edges = edges()

    for {app, prefixes} <- apps do
      own = Enum.filter(edges, fn {from, _to} -> owners[from] == app end)
      uses = MapSet.new(own, fn {_from, to} -> owners[to] end)

      %{
        name: app,
        prefixes: prefixes,
        main: prefixes |> hd() |> Macro.underscore() |> Path.split(),
        files: files(app),
        modules: Enum.map(modules[app], &elem(&1, 0)),
        edges: Enum.filter(own, fn {_from, to} -> owners[to] == app end),
        uses: for({used, _prefixes} <- apps, used != app, used in uses, do: used),
        names: names(app, known)
      }
    end
  end

  defp files(app) do
    lib = Path.join(@root, "apps/#{app}/lib")
    for file <- Path.wildcard("#{lib}/**/*.ex"), do: file |> Path.relative_to(lib) |> Path.rootname()
  end

  # mix xref names a file by its path below the app.
  defp owned(owners, file, app) do
    Map.update(owners, file, app, &raise("apps/#{&1} and apps/#{app} both have lib/#{file}.ex; rename one"))
  end

  defp edges do
    args = ~w(xref graph --no-compile --no-deps-check --format dot --output -)
    {text, 0} = System.cmd("mix", args, cd: @root, env: [{"MIX_ENV", environment()}], stderr_to_stdout: true)
    for [_, from, to] <- Regex.scan(~r/"lib\/(.+)\.ex" -> "lib\/(.+)\.ex"/, text), do: {from, to}
  end

  # Modules with their files. Test support lies outside lib/.
  defp modules(app) do
    for beam <- Path.wildcard("#{@root}/_build/#{environment()}/lib/#{app}/ebin/Elixir.*.beam"),
        {:ok, {_module, [compile_info: info]}} = :beam_lib.chunks(String.to_charlist(beam), [:compile_info]),
        [_, file] <- [Regex.run(~r/.*\/apps\/#{app}\/lib\/(.+)\.ex$/, to_string(info[:source]))] do
      {beam |> Path.basename(".beam") |> String.replace_prefix("Elixir.", ""), file}
    end
  end

  defp environment, do: System.get_env("MIX_ENV", "test")

  defp names(app, known) do
    app
    |> files()
    |> Task.async_stream(fn file ->
      names = @root |> Path.join("apps/#{app}/lib/#{file}.ex") |> File.read!() |> named()

      others =
        for module <- names,
            {owner, path} <- [known[module]],
            {owner, path} != {app, file},
            uniq: true,
            do: {owner, group(module)}

      {file, others}
    end)
    |> Map.new(fn {:ok, pair} -> pair end)
  end

  defp group(module) do
    case Enum.find(@generated, &String.starts_with?(module, &1)) do
      nil -> module
      group -> group <> "*"
    end
  end

  @doc """
  The whole names of the modules in a source text. A template is only a string here; what it uses counts by the aliases
  in front of it.
  """
  def named(text) do
    {_ast, {names, _aliases}} =
      text |> Code.string_to_quoted!(emit_warnings: false) |> Macro.prewalk({MapSet.new(), %{}}, &name/2)

    names
  end

  defp name({:defmodule, _, [{:__aliases__, _, parts} | _]} = node, {names, aliases}),
    do: {node, {names, Map.put_new(aliases, :__MODULE__, parts)}}

  defp name({:alias, _, [{{:., _, [base, :{}]}, _, targets}]}, acc) do
    {nil,
     Enum.reduce(targets, acc, fn {:__aliases__, _, parts}, acc ->
       alias_as(parts(base) ++ parts, List.last(parts), acc)
     end)}
  end

  defp name({:alias, _, [target | options]}, acc) do
    parts = parts(target)

    case options do
      [[as: {:__aliases__, _, [as]}]] -> {nil, alias_as(parts, as, acc)}
      [] -> {nil, alias_as(parts, List.last(parts), acc)}
    end
  end

  defp name({:__aliases__, _, parts} = node, {names, aliases}),
    do: {node, {put(names, whole(parts, aliases)), aliases}}

  defp name(node, acc), do: {node, acc}

  defp parts({:__aliases__, _, parts}), do: parts
  defp parts({:__MODULE__, _, _} = own), do: [own]

  defp alias_as(parts, as, {names, aliases}) do
    whole = whole(parts, aliases)
    {put(names, whole), Map.put(aliases, as, whole)}
  end

  defp whole([{:__MODULE__, _, _} | rest], aliases), do: Map.get(aliases, :__MODULE__, []) ++ rest
  defp whole([first | rest], aliases), do: Map.get(aliases, first, [first]) ++ rest

  defp put(names, parts),
    do: if(Enum.all?(parts, &is_atom/1), do: MapSet.put(names, Enum.join(parts, ".")), else: names)
end
