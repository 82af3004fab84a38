defmodule MavCodec.Generated.Enums.Part4 do
  use MavCodec.Definition.Shard, enums: {4, 4}
end
