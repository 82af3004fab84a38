defmodule Aerie.System.DocsTest do
  @moduledoc "What `bin/docs` makes: every link within it leads somewhere, and it loads nothing from elsewhere."

  use ExUnit.Case, async: true

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)

  @tag :long
  test "the documentation is made without a warning, and complete in itself", %{tmp_dir: dir} do
    assert {_output, 0} = System.cmd(Path.join(@root, "bin/docs"), [dir], stderr_to_stdout: true)
    pages = Map.new(Path.wildcard(Path.join(dir, "*.html")), &{Path.basename(&1), File.read!(&1)})

    # The guides and references, a module of each app.
    guides =
      for path <- Path.wildcard(Path.join(@root, "docs/**/*.md")), do: Path.basename(path, ".md")

    modules =
      ~w(Aerie.Shell Aerie.Api.Metrics Aerie.Control.Policy MavCodec.Messages.Heartbeat MavRouter.Router SimVehicle) ++
        ~w(Gnat)

    for name <- guides ++ modules, do: assert(pages[name <> ".html"], name)

    for {name, page} <- pages do
      refute page =~ ~r/<(script|link|img)[^>]* (src|href)="(https?:)?\/\//, name

      for [_all, file | anchor] <- Regex.scan(~r/ href="([^"#:?]*)(?:#([^"]*))?"/, page),
          name not in ["404.html"] do
        assert file == "" or File.exists?(Path.join(dir, URI.decode(file))), "#{name}: #{file}"

        # ex_doc has checked those to modules. (It takes the types of the module :telemetry for anchors of telemetry.html.)
        for place <- anchor,
            file in Enum.map(guides, &"#{&1}.html"),
            not String.starts_with?(place, "t:"),
            do: assert(pages[file] =~ ~s( id="#{place}"), "#{name}: #{file}##{place}")
      end
    end
  end
end
