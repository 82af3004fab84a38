# Names in READMEs, docs and module documentation that do not exist (modules, functions, tests, linked files), and
# test modules that are not named as their files. bin/test calls References.main(), which prints file, line and name.
defmodule References do
  @sources [
    "{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}",
    "packages/*.exs",
    "{test,test_kit,bin}/**/*.{ex,exs}"
  ]
  @pages [
    "*.md",
    "{docs,bin,rel,test,test_kit}/**/*.md",
    "packages/*.md",
    "{apps,packages}/*/*.md",
    "{apps,packages}/*/{lib,priv,test,bench}/**/*.md"
  ]

  # Made from the MAVLink definitions when mav_codec is compiled.
  @generated ~r/^MavCodec\.(Messages|Enums|Dialects)\b/
  # A name of a process, without a module; modules of examples; modules of other libraries, among them what packages/
  # lack of their namesakes.
  @elsewhere ~r/^(Aerie\.CLI\.Supervisor|MyApp|Mod|Plug|Gnat\.Services|Phoenix\.(ConnTest|HTML\.Safe|LiveComponent))\b/
  # Their functions are called without the module's name.
  @imported [Kernel, Kernel.SpecialForms, GenServer, Supervisor, ExUnit.Assertions, ExUnit.Callbacks]

  @module ~r/`&?(?:[ct]:)?%?((?:[A-Z][A-Za-z0-9]*\.(?=[A-Z]))++[A-Z][A-Za-z0-9]*+)(?!\.[a-z_])/
  @word ~r/`([A-Z][a-z][A-Za-z0-9]*)`/
  @arity ~r/`&?(?:[ct]:)?((?:[A-Z][A-Za-z0-9]*\.)*)([a-z_]\w*[?!]?)\/(\d+)`/
  @function ~r/`&?((?:[A-Z][A-Za-z0-9]*\.)+)([a-z_]\w*[?!]?)`/
  @call ~r/(?<![\w.])((?:[A-Z][A-Za-z0-9]*\.)+)([a-z_]\w*[?!]?)\(/
  @test ~r/`(?:[\w.]+\/)*(\w+_test)(?:\.exs)?`/
  @file_name ~r/`((?:[\w-]+\/)*\w+\.exs?)`/
  @link ~r/\]\(([^)#: ]+)(?:#[^)]*)?\)/

  def main do
    found = check(read(@sources), read(@pages), &File.exists?/1)
    Enum.each(found, &IO.puts(:stderr, &1))
    if found != [], do: System.halt(1)
  end

  defp read(wildcards),
    do: for(wildcard <- wildcards, file <- Path.wildcard(wildcard), do: {file, File.read!(file)})

  # Tests of checks name what does not exist.
  @made_up "test/gate/"

  # What is wrong in sources and pages, each `{file, text}`.
  def check(sources, pages, exists?) do
    sources =
      sources |> Task.async_stream(&source/1, timeout: :infinity) |> Enum.map(fn {:ok, source} -> source end)

    known = known(sources, exists?)

    in_sources =
      for source <- sources, not String.starts_with?(source.file, @made_up) do
        missing(source.file, source.quotes, [:module, :word, :arity, :function], known) ++
          missing(source.file, source.docs, [:call], known)
      end

    in_pages =
      for {file, text} <- pages,
          do: missing(file, numbered(text), [:module, :arity, :function, :call, :test, :file, :link], known)

    found = List.flatten(in_sources ++ in_pages ++ Enum.map(sources, &misnamed/1))
    for {file, line, text} <- found |> Enum.uniq() |> Enum.sort(), do: "#{file}:#{line}: #{text}"
  end

  # A process for each: its syntax tree is too much to be carried along.
  defp source({file, text}) do
    ast = Code.string_to_quoted!(text, emit_warnings: false)
    quotes = for {line, _number} = numbered <- numbered(text), String.contains?(line, "`"), do: numbered
    %{file: file, text: text, modules: modules(ast), docs: docs(ast), quotes: quotes}
  end

  defp numbered(text, first \\ 1), do: text |> String.split("\n") |> Enum.with_index(first)

  # The lines of the documentation.
  defp docs(ast) do
    {_ast, docs} =
      Macro.prewalk(ast, [], fn
        {:@, meta, [{kind, _, [text]}]}, docs when kind in [:moduledoc, :doc, :typedoc] and is_binary(text) ->
          {nil, numbered(text, meta[:line] + if(text =~ "\n", do: 1, else: 0)) ++ docs}

        node, docs ->
          {node, docs}
      end)

    docs
  end

  defp known(sources, exists?) do
    modules =
      for source <- sources,
          {name, functions} <- source.modules,
          do: %{name: name, file: source.file, functions: MapSet.new(functions)}

    %{
      modules: modules,
      # By each name that can mean it: Aerie.Fleet.Nats, Fleet.Nats, Nats. Folders have names without a module.
      names:
        for(module <- modules, {name, itself} <- names(module.name), reduce: %{}) do
          names ->
            Map.update(
              names,
              name,
              if(itself, do: [module], else: []),
              &if(itself, do: [module | &1], else: &1)
            )
        end,
      files: Map.new(sources, &{&1.file, &1.text}),
      tests: Enum.map(sources, &Path.basename(&1.file, ".exs")),
      exists?: exists?
    }
  end

  defp names(module) do
    parts = String.split(module, ".")

    for last <- 1..length(parts),
        first <- 1..last,
        do: {parts |> Enum.slice((first - 1)..(last - 1)) |> Enum.join("."), last == length(parts)}
  end

  ## Modules of a file, with what they define: `{name, arity}`, `{field, :field}`, `{:use, module}`, or `:any` if names
  ## are computed.

  defp modules(ast),
    do: ast |> definitions(nil) |> Enum.group_by(&elem(&1, 0), &elem(&1, 1)) |> Map.delete(nil)

  defp definitions({:defmodule, _, [name, body]}, outer) do
    module = Enum.join(List.wrap(outer) ++ [Macro.to_string(name)], ".")
    [{module, :module} | definitions(body, module)]
  end

  defp definitions({:defprotocol, meta, arguments}, outer),
    do: definitions({:defmodule, meta, arguments}, outer)

  defp definitions({kind, _, [head | body]}, module)
       when kind in [:def, :defp, :defmacro, :defmacrop, :defguard, :defguardp, :defdelegate],
       do: Enum.map(heads(head), &{module, &1}) ++ definitions(body, module)

  defp definitions({:defstruct, _, [fields]}, module) when is_list(fields) do
    for field <- fields,
        name = if(is_tuple(field), do: elem(field, 0), else: field),
        do: {module, {"#{name}", :field}}
  end

  defp definitions({:@, _, [{kind, _, [spec]}]}, module)
       when kind in [:callback, :macrocallback, :type, :typep, :opaque],
       do: Enum.map(heads(spec), &{module, &1})

  defp definitions({:@, _, [{:behaviour, _, [{:__aliases__, _, _} = used]}]}, module),
    do: [{module, {:use, Macro.to_string(used)}}]

  defp definitions({kind, _, [{:__aliases__, _, _} = used | _]}, module) when kind in [:use, :import],
    do: [{module, {:use, Macro.to_string(used)}}]

  defp definitions({head, _, arguments}, module),
    do: definitions(head, module) ++ definitions(arguments, module)

  defp definitions({left, right}, module), do: definitions(left, module) ++ definitions(right, module)
  defp definitions(list, module) when is_list(list), do: Enum.flat_map(list, &definitions(&1, module))
  defp definitions(_leaf, _module), do: []

  defp heads({kind, _, [head | _]}) when kind in [:when, :"::"], do: heads(head)
  defp heads({:unquote, _, _}), do: [:any]
  defp heads({{:unquote, _, _}, _, _}), do: [:any]

  defp heads({name, _, arguments}) when is_atom(name) do
    arguments = if is_list(arguments), do: arguments, else: []
    defaults = Enum.count(arguments, &match?({:\\, _, _}, &1))
    for arity <- (length(arguments) - defaults)..length(arguments), do: {Atom.to_string(name), arity}
  end

  defp heads(_head), do: []

  ## Names

  defp missing(file, lines, kinds, known) do
    for {text, line} <- lines,
        kind <- kinds,
        text <- find(kind, text, file, known),
        do: {file, line, text}
  end

  defp find(:module, text, _file, known) do
    for [_, name] <- Regex.scan(@module, text), not module?(name, known), do: "#{name} does not exist"
  end

  # A module's last name alone means one beside the file, or one that its code names.
  defp find(:word, text, file, known) do
    with [_ | _] = words <- Regex.scan(@word, text) do
      for [quoted, word] <- words,
          own = Enum.filter(known.names[word] || [], &(top(&1.file) == top(file))),
          own != [] and not Enum.any?(own, &within?(&1.file, Path.dirname(file))),
          not (known.files[file] |> String.replace(quoted, "") |> String.match?(~r/\b#{word}\b/)),
          do: "#{word} is not in this folder: write more of its name (#{Enum.map_join(own, ", ", & &1.name)})"
    end
  end

  defp find(:arity, text, file, known) do
    for [_, module, function, arity] <- Regex.scan(@arity, text),
        definition = {function, String.to_integer(arity)},
        not function?(module, definition, file, known) do
      if module == "",
        do:
          "#{function}/#{arity} does not exist here: write Module.#{function}/#{arity} if another module has it",
        else: "#{module}#{function}/#{arity} does not exist"
    end
  end

  defp find(kind, text, file, known) when kind in [:function, :call] do
    pattern = if kind == :function, do: @function, else: @call

    for [_, module, function] <- Regex.scan(pattern, text),
        not function?(module, {function, :any}, file, known),
        do: "#{module}#{function} does not exist"
  end

  # MAV_CMD has a command of the name motor_test.
  defp find(:test, text, _file, known) do
    for [_, name] <- Regex.scan(@test, text),
        name not in ["motor_test" | known.tests],
        do: "#{name} does not exist"
  end

  # CONTRIBUTING's examples have the name NAME.
  defp find(:file, text, file, known) do
    for [_, name] <- Regex.scan(@file_name, text),
        not (name =~ "NAME" or exists?(file, name, known)),
        not Enum.any?(known.files, fn {source, _text} -> String.ends_with?(source, "/" <> name) end),
        do: "#{name} does not exist"
  end

  defp find(:link, text, file, known),
    do:
      for([_, name] <- Regex.scan(@link, text), not exists?(file, name, known), do: "#{name} does not exist")

  defp module?(name, known), do: is_map_key(known.names, name) or elixir?(name) or foreign?(name)

  # MAVLink's names, such as ATTITUDE.roll, have no small letters.
  defp foreign?(name), do: name =~ @generated or name =~ @elsewhere or name == String.upcase(name)

  defp elixir?(name), do: Code.ensure_loaded?(Module.concat([name]))

  # `main/7` is a vehicle.
  defp function?("", {"main", _arity}, _file, _known), do: true

  defp function?("", definition, file, known) do
    here =
      Enum.filter(
        known.modules,
        &if(Path.extname(file) == ".md", do: beside?(&1.file, file), else: &1.file == file)
      )

    Enum.any?(here, &defines?(&1, definition, known)) or Enum.any?(@imported, &exports?(&1, definition))
  end

  defp function?(module, {function, _arity} = definition, _file, known) do
    name = String.trim_trailing(module, ".")
    modules = known.names[name] || []

    cond do
      Enum.any?(modules, &defines?(&1, definition, known)) -> true
      elixir?(name) -> exports?(Module.concat([name]), definition)
      # A file of another project: `GCS.cpp`.
      modules == [] -> foreign?(name) or function in ~w(cc cpp h)
      true -> false
    end
  end

  # The module itself, or one that it uses.
  defp defines?(module, definition, known) do
    used = for {:use, used} <- module.functions, module <- known.names[used] || [], do: module
    Enum.any?([module | used], &own?(&1.functions, definition))
  end

  defp own?(functions, {name, :any}), do: Enum.any?(functions, &(&1 == :any or match?({^name, _}, &1)))
  defp own?(functions, definition), do: :any in functions or definition in functions

  defp exports?(module, {name, arity}) do
    Code.ensure_loaded!(module)

    callbacks =
      if function_exported?(module, :behaviour_info, 1), do: module.behaviour_info(:callbacks), else: []

    all = module.module_info(:exports) ++ module.__info__(:macros) ++ callbacks
    Enum.any?(all, fn {exported, n} -> Atom.to_string(exported) == name and arity in [:any, n] end)
  end

  ## Files

  defp top(file), do: file |> Path.split() |> Enum.take(2) |> Path.join()
  defp within?(file, folder), do: String.starts_with?(file, folder <> "/")

  # A README is about its folder and the module that the folder belongs to; docs/ are about all.
  defp beside?(file, page) do
    folder = Path.dirname(page)
    folder == "." or String.starts_with?(folder, "docs") or within?(file, folder) or file == folder <> ".ex"
  end

  # Beside the page, in its app, or from the root.
  defp exists?(file, name, known),
    do: Enum.any?([Path.dirname(file), top(file), "."], &known.exists?.(Path.join(&1, name)))

  ## Test modules: apps/base/test/aerie/log_test.exs has Aerie.LogTest, apps/msp/test/log_test.exs also Msp.LogTest,
  ## test/system/log_test.exs Aerie.System.LogTest.

  defp misnamed(%{file: file, modules: modules}) do
    names = Map.keys(modules)

    with [_, app, path] <- Regex.run(~r{^(?:(?:apps|packages)/([^/]+)/)?test/(.+_test)\.exs$}, file),
         wanted = if(app == "", do: ["aerie/" <> path], else: [path, app <> "/" <> path]),
         false <- Enum.any?(wanted, &(flat(Macro.camelize(&1)) in Enum.map(names, fn name -> flat(name) end))) do
      [
        {file, 1,
         "the test module #{List.first(names)} is not named as its file: #{Macro.camelize(hd(wanted))}"}
      ]
    else
      _named -> []
    end
  end

  # Acronyms may be written as they are.
  defp flat(name), do: name |> String.replace("_", "") |> String.downcase()
end
