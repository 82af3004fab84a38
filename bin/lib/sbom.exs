# What a release consists of: `elixir bin/lib/sbom.exs RELEASE` writes sbom.cdx.json (CycloneDX) and the licences into its folder.
#
# Debian's packages are known by the toolchain's packages/ (bin/lib/toolchain.sh), npm's by package-lock.json. Each component names the
# places in the release that come from it, so that nothing in the release is without one (test/system/release_test.exs).
defmodule Sbom do
  # Of Debian's sources without the version in their names. A package also has files under further licences: its own text, which is
  # copied, names them.
  @licences %{
    "elixir-lang" => "Apache-2.0",
    "erlang" => "Apache-2.0",
    "erlang-cowboy" => "ISC",
    "erlang-cowlib" => "ISC",
    "erlang-p1-utils" => "Apache-2.0",
    "erlang-p1-yaml" => "Apache-2.0",
    "erlang-ranch" => "ISC",
    "gcc" => "GPL-3.0-or-later WITH GCC-exception-3.1",
    "glibc" => "LGPL-2.1-or-later",
    "libyaml" => "MIT",
    "libzstd" => "BSD-3-Clause OR GPL-2.0-only",
    "lksctp-tools" => "LGPL-2.1-or-later",
    "nats-server" => "Apache-2.0",
    "ncurses" => "X11-distribute-modifications-variant",
    "openssl" => "Apache-2.0",
    "systemd" => "LGPL-2.1-or-later",
    "xz-utils" => "0BSD",
    "zlib" => "Zlib",
    # What is linked into nats-server.
    "golang" => "BSD-3-Clause",
    "golang-github-antithesishq-antithesis-sdk-go" => "MIT",
    "golang-github-klauspost-compress" => "Apache-2.0 AND BSD-3-Clause AND MIT",
    "golang-github-minio-highwayhash" => "Apache-2.0",
    "golang-github-nats-io-jwt" => "Apache-2.0",
    "golang-github-nats-io-nkeys" => "Apache-2.0",
    "golang-github-nats-io-nuid" => "Apache-2.0",
    "golang-go.crypto" => "BSD-3-Clause",
    "golang-golang-x-sys" => "BSD-3-Clause",
    "golang-golang-x-time" => "BSD-3-Clause"
  }

  def run(release, root, toolchain) do
    version = release |> Path.join("releases/start_erl.data") |> File.read!() |> String.split() |> List.last()
    places = places(release)
    own = own(root, places)
    debian = debian(toolchain, places)
    npm = npm(root, release)
    known = for component <- own ++ debian, place <- located(component), do: place
    components = own ++ debian ++ npm ++ Enum.map(places -- known, &other/1)

    # The keys are strings, because the order of atoms differs between runs.
    bom = %{
      "bomFormat" => "CycloneDX",
      "specVersion" => "1.6",
      "version" => 1,
      "metadata" => %{
        "component" =>
          component("application", "aerie", version, "pkg:generic/aerie@#{version}", "Apache-2.0", [], "LICENSE")
      },
      "components" => Enum.sort_by(components, &{&1["name"], &1["bom-ref"]})
    }

    File.write!(Path.join(release, "sbom.cdx.json"), :json.format(bom))
    for {text, source} <- texts(components, toolchain, root), do: copy(source, Path.join(release, text))
  end

  # What somebody else may have made; the rest of a release is Aerie's scripts and files.
  defp places(release) do
    for pattern <- ~w(erts-*/bin/* lib/* usr/lib/*/* bin/nats-server bin/xz),
        path <- Path.wildcard(Path.join(release, pattern)),
        # The script that starts it stands for it.
        not String.ends_with?(path, ".elf"),
        do: Path.relative_to(path, release)
  end

  defp located(component), do: for(place <- component["evidence"]["occurrences"] || [], do: place["location"])

  defp component(type, name, version, purl, licence, places, text) do
    component = %{
      "type" => type,
      "bom-ref" => purl,
      "name" => name,
      "version" => version,
      "purl" => purl,
      "licenses" => [if(licence, do: %{"expression" => licence}, else: %{"license" => %{"name" => "see #{text || "its own files"}"}})]
    }

    component = if text, do: Map.put(component, "properties", [%{"name" => "aerie:licence", "value" => text}]), else: component
    occurrences = for place <- places, do: %{"location" => place}
    if places == [], do: component, else: Map.put(component, "evidence", %{"occurrences" => occurrences})
  end

  defp own(root, places) do
    # Elsewhere (AERIE_PACKAGES) they are their namesakes.
    folders = if System.get_env("AERIE_PACKAGES", "") == "", do: ~w(apps packages), else: ~w(apps)

    for "lib/" <> folder = place <- places,
        [name, version] = String.split(folder, "-", parts: 2),
        kind <- folders,
        File.dir?(Path.join([root, kind, name])) do
      component = component("library", name, version, "pkg:generic/aerie/#{name}@#{version}", "Apache-2.0", [place], "LICENSE")
      if kind == "packages" and name != "nkey", do: Map.put(component, "description", "Aerie's own, with the API of its namesake"), else: component
    end
  end

  defp debian(toolchain, places) do
    for line <- lines(Path.join(toolchain, "packages/index")),
        [name, version, architecture, source, linked, sha256] = String.split(line, "\t"),
        files = lines(Path.join(toolchain, "packages/#{name}.files")),
        [_place | _more] = found <- [Enum.filter(places, &has?(files, packaged(&1)))] do
      type = if Enum.any?(found, &String.starts_with?(&1, "bin/")), do: "application", else: "library"

      type
      |> component(name, version, deb(name, version, architecture), licence(source), found, "licences/debian/#{name}")
      |> Map.put("hashes", [%{"alg" => "SHA-256", "content" => sha256}])
      |> linked(linked, toolchain)
    end
  end

  defp has?(files, place), do: Enum.any?(files, &(&1 == place or String.starts_with?(&1, place <> "/")))

  # Where the package has what stands in the release.
  defp packaged("lib/" <> folder) do
    [name, _version] = String.split(folder, "-", parts: 2)
    if name in ~w(eex elixir iex logger), do: "usr/lib/elixir/lib/#{name}", else: "usr/lib/erlang/lib/#{folder}"
  end

  defp packaged("erts-" <> _rest = file), do: "usr/lib/erlang/#{file}"
  defp packaged("bin/nats-server"), do: "usr/sbin/nats-server"
  defp packaged("bin/xz"), do: "usr/bin/xz"
  defp packaged(library), do: library

  defp linked(component, "", _toolchain), do: component

  defp linked(component, sources, toolchain) do
    Map.put(
      component,
      "components",
      for [_all, name, version] <- Regex.scan(~r/(\S+) \(= (\S+)\)/, sources) do
        text = if File.exists?(Path.join(toolchain, "packages/#{name}.copyright")), do: "licences/debian/#{name}"
        component("library", name, version, deb(name, version, "source"), licence(name), [], text)
      end
    )
  end

  defp licence(source), do: @licences[String.replace(source, ~r/-[0-9.]+$/, "")]

  defp deb(name, version, architecture) do
    [name, version] = for text <- [name, version], do: URI.encode(text, &URI.char_unreserved?/1)
    "pkg:deb/debian/#{name}@#{version}?arch=#{architecture}"
  end

  defp npm(root, release) do
    locked = root |> Path.join("package-lock.json") |> File.read!() |> JSON.decode!()

    # A package may be in the folder of its scope: @scope/name.
    for folder <- Path.wildcard(Path.join(release, "lib/console-*/priv/console/node_modules")),
        path <- Path.wildcard(folder <> "/*") ++ Path.wildcard(folder <> "/@*/*"),
        name = Path.relative_to(path, folder),
        String.starts_with?(name, "@") == String.contains?(name, "/") do
      %{"version" => version, "license" => licence, "integrity" => "sha512-" <> hash} = locked["packages"]["node_modules/#{name}"]
      content = hash |> Base.decode64!() |> Base.encode16(case: :lower)

      "library"
      |> component(name, version, "pkg:npm/#{String.replace(name, "@", "%40")}@#{version}", licence, [Path.relative_to(path, release)], "licences/npm/#{name}")
      |> Map.put("hashes", [%{"alg" => "SHA-512", "content" => content}])
    end
  end

  # With Erlang of the machine, or libraries from elsewhere, only names are known.
  defp other(place) do
    [name | version] = place |> Path.basename() |> String.split(~r/-(?=\d)/, parts: 2)
    version = List.first(version, "unknown")
    component("library", name, version, "pkg:generic/#{name}@#{version}", nil, [place], nil)
  end

  defp texts(components, toolchain, root) do
    named =
      for %{"properties" => [%{"value" => text}]} <- Enum.flat_map(components, &[&1 | Map.get(&1, "components", [])]) do
        case text do
          "licences/debian/" <> name -> {text, Path.join(toolchain, "packages/#{name}.copyright")}
          "licences/npm/" <> name -> {text, npm_licence(Path.join([root, "node_modules", name]))}
          "LICENSE" -> {text, Path.join(root, text)}
        end
      end

    # Debian's texts refer to those that many packages have.
    common =
      for {"licences/debian/" <> _name, source} <- named,
          [_all, name] <- Regex.scan(~r{/usr/share/common-licenses/([\w.-]*\w)}, File.read!(source)),
          path = Path.join([toolchain, "packages", name]),
          File.exists?(path),
          uniq: true,
          do: {"licences/debian/common-licenses/#{name}", path}

    named ++ common
  end

  # A package without a file of its licence names it beside its author in package.json.
  defp npm_licence(folder),
    do: folder |> Path.join("LICENSE*") |> Path.wildcard() |> List.first(Path.join(folder, "package.json"))

  defp copy(source, target) do
    File.mkdir_p!(Path.dirname(target))
    File.cp!(source, target)
  end

  defp lines(path) do
    case File.read(path) do
      {:ok, text} -> String.split(text, "\n", trim: true)
      {:error, :enoent} -> []
    end
  end
end

[release] = System.argv()
Sbom.run(release, System.fetch_env!("AERIE_ROOT"), System.fetch_env!("AERIE_TOOLCHAIN"))
