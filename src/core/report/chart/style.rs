//! The one style of all charts: light, dark, and light on paper.

/// Rules for the classes of the drawings. The palette is Okabe and Ito's, distinguishable for colour-blind readers, as their paper says; lighter on dark ground.
pub const CHART_STYLE: &str = "\
:root{color-scheme:light dark;--paper:#fff;--ink:#1d1d1d;--soft:#555;--faint:#e4e4e4;--frame:#999;--red:#c0392b;\
--c0:#0072b2;--c1:#d55e00;--c2:#00805c;--c3:#b0508a;--c4:#2f8fd0;--c5:#a87400;--c6:#5a5a5a;--blind:#d55e0026;--busy:#0072b21f;--hold:#a8740038}\
@media (prefers-color-scheme:dark){:root{--paper:#15181c;--ink:#e8e8e8;--soft:#aab0b6;--faint:#2c3138;--frame:#6c737b;--red:#ff7b6b;\
--c0:#5ab4f0;--c1:#ff9a52;--c2:#3ecfa0;--c3:#eb9bc9;--c4:#9ad2ff;--c5:#f0c04a;--c6:#c4c8cc;--blind:#ff9a5238;--busy:#5ab4f02b;--hold:#f0c04a3a}}\
@media print{:root{--paper:#fff;--ink:#000;--soft:#444;--faint:#ddd;--frame:#888;--red:#b03020;--c0:#0072b2;--c1:#d55e00;--c2:#00805c;\
--c3:#b0508a;--c4:#2f8fd0;--c5:#a87400;--c6:#5a5a5a;--blind:#d55e0026;--busy:#0072b21f;--hold:#a8740038}}\
.chart{font-family:system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif}\
.chart path,.chart rect,.chart circle{fill:none;stroke:none;vector-effect:none}\
.chart .t{fill:var(--ink);stroke:none}.chart .tb{font-weight:600}.chart .tm{fill:var(--soft)}\
.chart .halo{paint-order:stroke;stroke:var(--paper);stroke-width:4;stroke-linejoin:round}.chart .frame{stroke:var(--frame);stroke-width:1}.chart .grid{stroke:var(--faint);stroke-width:1}\
.chart .line{stroke-width:1.8;stroke-linejoin:round;stroke-linecap:round}.chart .dash{stroke-dasharray:6 4}.chart .thin{stroke-width:1}\
.chart .mark{stroke-width:1.8}.chart .limit{stroke:var(--red);stroke-width:1.4;stroke-dasharray:2 3}\
.chart .leader{stroke:var(--frame);stroke-width:.8}.chart .ground{stroke:var(--faint);stroke-width:1}.chart .link{stroke:var(--c6);stroke-width:5;\
stroke-linejoin:round;stroke-linecap:round;opacity:.55}.chart .link.faded{opacity:.22}.chart .plate{fill:var(--busy);stroke:var(--c6);stroke-width:1.2}\
.chart .flag{fill:var(--ink)}.chart .flagtext{fill:var(--paper);font-weight:600}\
.chart .axis-x{stroke:var(--c1);stroke-width:2}.chart .axis-y{stroke:var(--c2);stroke-width:2}.chart .axis-z{stroke:var(--c0);stroke-width:2}\
.chart .c0{stroke:var(--c0)}.chart .c1{stroke:var(--c1)}.chart .c2{stroke:var(--c2)}.chart .c3{stroke:var(--c3)}.chart .c4{stroke:var(--c4)}\
.chart .c5{stroke:var(--c5)}.chart .c6{stroke:var(--c6)}\
.chart .f0{fill:var(--c0)}.chart .f1{fill:var(--c1)}.chart .f2{fill:var(--c2)}.chart .f3{fill:var(--c3)}.chart .f4{fill:var(--c4)}\
.chart .f5{fill:var(--c5)}.chart .f6{fill:var(--c6)}\
.chart .b0{fill:var(--busy)}.chart .b1{fill:var(--blind)}.chart .b2{fill:var(--hold)}.chart .b3{fill:var(--faint)}.chart .b4{fill:var(--busy)}\
.chart .b5{fill:var(--hold)}.chart .b6{fill:var(--faint)}";
